"""The library of the system that pictures are drawn with, without a screen.

It is the one that `MUJOCO_GL` names (`egl`, `osmesa` or `glfw`); without that variable EGL if the
system has it, else OSMesa. MuJoCo's own default is a window system, which the machines that train
policies rarely have.
"""

import ctypes.util
import importlib
import os
import warnings
from types import ModuleType
from typing import Any

# Library -> module of MuJoCo that opens a context with it, name of the shared object.
_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
_MODULES = {"egl": "mujoco.egl", "osmesa": "mujoco.osmesa", "glfw": "mujoco.glfw"}


class RenderingError(RuntimeError):
    """Nothing can be drawn here; the message is one sentence that says what to install."""


# What MuJoCo, PyOpenGL and GLFW raise where a shared object, a driver or a screen is missing.
_MISSING = (ImportError, AttributeError, OSError, RuntimeError)


def _import_mujoco() -> ModuleType:
    """Import MuJoCo, which fails as a whole if MUJOCO_GL names a library that is not installed.

    Training needs no pictures, so this must not stop it.
    """
    try:
        return importlib.import_module("mujoco")
    except _MISSING:
        asked = os.environ.pop("MUJOCO_GL", None)
        if asked is None:
            raise
        try:
            return importlib.import_module("mujoco")
        finally:
            os.environ["MUJOCO_GL"] = asked


_mujoco: Any = _import_mujoco()


def open_context(model: Any, width: int, height: int) -> tuple[Any, Any]:
    """Return a drawing context of the system, made current, and MuJoCo's own for a model in it.

    Args:
        model: a compiled model.
        width: of the pictures, in pixels.
        height: of the pictures, in pixels.

    Raises:
        RenderingError: the system has no library to draw with.
    """
    library = _library()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of GLFW, in place of exceptions
            context = importlib.import_module(_MODULES[library]).GLContext(width, height)
            context.make_current()
        return context, _mujoco.MjrContext(model, _mujoco.mjtFontScale.mjFONTSCALE_100)
    except (*_MISSING, _mujoco.FatalError) as error:
        raise _nothing_to_draw_with(f"`{library}` cannot be used ({error})") from error


def _library() -> str:
    asked = os.environ.get("MUJOCO_GL", "").strip().lower()
    if asked in _MODULES:
        return asked
    if asked:
        raise _nothing_to_draw_with(f"the variable MUJOCO_GL is `{asked}`")
    for library, shared_object in _LIBRARIES.items():
        if ctypes.util.find_library(shared_object):
            return library
    raise _nothing_to_draw_with("neither EGL nor OSMesa is installed")


def _nothing_to_draw_with(why: str) -> RenderingError:
    reason = " ".join(why.split())
    return RenderingError(
        f"pictures need a library that draws without a screen, but {reason}: install EGL (package "
        "libegl1 on Debian and Ubuntu) or OSMesa (libosmesa6), and set MUJOCO_GL to the one that "
        "is there (`egl`, `osmesa`) or not at all."
    )
