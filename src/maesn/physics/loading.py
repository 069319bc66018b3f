"""Reads the models of the library, and users' own, from their XML."""

import os
import warnings
from collections import deque
from importlib import resources
from pathlib import Path

import mujoco

# MuJoCo's latest warnings. By default it would print them and append them to a log file in the
# working directory, which may be read-only. Whoever steps simulations reads the warning counters
# instead. A built-in method, because MuJoCo calls this in the middle of C code and aborts the
# process if it raises: built-in code runs no bytecode, so not even Ctrl-C can raise in it.
_messages: deque[str] = deque(maxlen=16)


def load_model(model: str | os.PathLike[str]) -> mujoco.MjModel:
    """Compile a model.

    Automatic resets are switched off, whatever the file says: MuJoCo would otherwise put a
    simulation that blows up back to its initial state, without an error, and an episode would go
    on from there. Warnings of the compiler become Python warnings.

    Args:
        model: name of a model of the library, such as "wheeled", path of an MJCF or URDF file, or
            the XML itself.

    Returns:
        The compiled model.

    Raises:
        FileNotFoundError: there is neither such a model nor such a file.
        ValueError: MuJoCo cannot compile the XML; the message is one sentence.
    """
    _redirect_warnings()
    _messages.clear()
    try:
        compiled = _compile(os.fspath(model))
    except ValueError as error:
        said = " ".join(str(error).split())
        raise ValueError(
            f"`model` {label(model)!r} cannot be compiled, because MuJoCo says: {said}"
        ) from error
    for message in _messages:
        warnings.warn(f"model {label(model)!r}: {message}", stacklevel=2)
    compiled.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    return compiled


def label(model: str | os.PathLike[str]) -> str:
    """Return a model's name or path for a message; of XML itself, its first tag."""
    name = os.fspath(model)
    return f"{name.strip().partition('>')[0]}>" if _is_xml(name) else name


def find_model(model: str | os.PathLike[str]) -> str | Path:
    """Return the XML of a model, or where a user's file of it is.

    Args:
        model: as for `load_model`.

    Raises:
        FileNotFoundError: there is neither such a model nor such a file.
    """
    name = os.fspath(model)
    if _is_xml(name):
        return name
    files = (resources.files("maesn.physics") / "models").iterdir()
    own = {file.name: file for file in files if file.name.endswith(".xml")}
    for candidate in (name, f"{name}.xml"):
        if candidate in own:
            return own[candidate].read_text("utf-8")
    if not Path(name).is_file():
        raise FileNotFoundError(
            f"`model` must be one of {', '.join(sorted(own))} or the path of an XML file, got "
            f"{name!r}, which is neither: check the spelling, or the directory that a relative "
            "path starts in"
        )
    return Path(name)


def _is_xml(name: str) -> bool:
    return name.lstrip().startswith("<")


def _compile(name: str) -> mujoco.MjModel:
    found = find_model(name)
    if isinstance(found, Path):
        return mujoco.MjModel.from_xml_path(name)
    return mujoco.MjModel.from_xml_string(found)


def _redirect_warnings() -> None:
    """Collect MuJoCo's warnings, unless somebody else already does."""
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_messages.append)
