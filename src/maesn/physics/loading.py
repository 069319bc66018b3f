"""Load MuJoCo models: those of the library, and users' own."""

import os
import re
import warnings
from collections import deque
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from maesn.storage import RunError

# MuJoCo's latest warnings. By default MuJoCo prints them and appends them to a log file in the
# working directory, which may be read-only. (Engines read the warning counters instead.) MuJoCo
# calls the handler from C and aborts the process if it raises. So the handler is the built-in
# `deque.append`: it runs no bytecode in which Ctrl-C could raise.
_messages: deque[str] = deque(maxlen=16)

# In a model of the library: all of a model that the installed Gymnasium brings.
_OF_GYMNASIUM = "gymnasium_"  # how the names of such models begin
_INCLUDED = re.compile(r'<include file="gymnasium:([\w.]+)"/>')


def load_model(model: str | os.PathLike[str]) -> mujoco.MjModel:
    """Compile a model.

    Automatic resets are switched off, whatever the file says. Otherwise MuJoCo would reset a
    simulation that blows up, without an error, and its episode would continue from the initial
    state. Warnings of MuJoCo's compiler become Python warnings, except about models of Gymnasium,
    which no user of the library can change.

    Args:
        model: the name of a model of the library, such as "wheeled", the path of an MJCF or URDF
            file, or the XML itself.

    Raises:
        FileNotFoundError: there is neither such a model nor such a file.
        ValueError: MuJoCo cannot compile the XML; the message is one sentence.
        RunError: it is a model of Gymnasium, which is not installed.
    """
    if mujoco.get_mju_user_warning() is None:  # else another handler is installed
        mujoco.set_mju_user_warning(_messages.append)
    _messages.clear()
    try:
        found = find_model(model)
        is_file = isinstance(found, Path)
        read = mujoco.MjModel.from_xml_path if is_file else mujoco.MjModel.from_xml_string
        compiled = read(os.fspath(model) if is_file else found)
    except ValueError as error:
        said = " ".join(str(error).split())
        raise ValueError(
            f"`model` {label(model)!r} cannot be compiled, because MuJoCo says: {said}"
        ) from error
    for message in _messages if not label(model).startswith(_OF_GYMNASIUM) else ():
        warnings.warn(f"model {label(model)!r}: {message}", stacklevel=2)
    compiled.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    return compiled


def label(model: str | os.PathLike[str]) -> str:
    """Return a model's name or path, or the first tag of an XML text, for a message."""
    name = os.fspath(model)
    return f"{name.strip().partition('>')[0]}>" if _is_xml(name) else name


def find_model(model: str | os.PathLike[str]) -> str | Path:
    """Return the XML text of a model, or the path of a user's file; raises as `load_model`."""
    name = os.fspath(model)
    if _is_xml(name):
        return name
    files = (resources.files("maesn.physics") / "models").iterdir()
    shipped = {file.name: file for file in files if file.name.endswith(".xml")}
    for candidate in (name, f"{name}.xml"):
        if candidate in shipped:
            text = shipped[candidate].read_text("utf-8")
            return _INCLUDED.sub(lambda found: _elements_of(found[1]), text)
    if not Path(name).is_file():
        raise FileNotFoundError(
            f"`model` must be one of {', '.join(sorted(shipped))} or the path of an XML file, got "
            f"{name!r}, which is neither: check the spelling, or the directory that a relative "
            "path starts in"
        )
    return Path(name)


def _elements_of(name: str) -> str:
    """Return the elements of a model in Gymnasium's package, as XML."""
    found = find_spec("gymnasium")  # not imported, which takes a while
    if found is None or found.origin is None:
        raise RunError(
            "the robots of this family are those of Gymnasium, which is not installed: "
            "pip install -e '.[gym]' in the clone of the repository."
        )
    file = Path(found.origin).parent / "envs" / "mujoco" / "assets" / name
    root = ElementTree.fromstring(file.read_text("utf-8"))
    return "".join(ElementTree.tostring(element, "unicode") for element in root)


def _is_xml(name: str) -> bool:
    return name.lstrip().startswith("<")
