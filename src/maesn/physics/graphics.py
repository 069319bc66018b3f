"""Open an OpenGL context in which MuJoCo draws without a screen.

The environment variable `MUJOCO_GL` chooses the library (`egl`, `osmesa` or `glfw`). Without it we
take EGL if the system has it, else OSMesa. MuJoCo's own default needs a window system, which
machines that train policies rarely have.
"""

import ctypes.util
import importlib
import os
import warnings
from types import ModuleType
from typing import Any

# The shared object of each library that is looked for without `MUJOCO_GL`.
_SHARED_OBJECTS = {"egl": "EGL", "osmesa": "OSMesa"}
# For each of these, MuJoCo has a module that opens a context.
_LIBRARIES = ("egl", "osmesa", "glfw")


class RenderingError(RuntimeError):
    """Nothing can be drawn here; the message is one sentence that says what to install."""


# Errors of MuJoCo, PyOpenGL and GLFW if a shared object, a driver or a screen is missing.
_MISSING = (ImportError, AttributeError, OSError, RuntimeError)


def _import_mujoco() -> ModuleType:
    """Import MuJoCo, even if MUJOCO_GL names a library that is not installed.

    MuJoCo's import then fails, but training needs no pictures.
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
    """Open an OpenGL context, make it current, and load a compiled model into it.

    Sizes are in pixels. Returns the OpenGL context and MuJoCo's `MjrContext`; RenderingError says
    that the system has no library to draw with.
    """
    library = _library()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # GLFW warns instead of raising
            context = importlib.import_module(f"mujoco.{library}").GLContext(width, height)
            context.make_current()
        return context, _mujoco.MjrContext(model, _mujoco.mjtFontScale.mjFONTSCALE_100)
    except (*_MISSING, _mujoco.FatalError) as error:
        raise _rendering_error(f"`{library}` cannot be used ({error})") from error


def _library() -> str:
    asked = os.environ.get("MUJOCO_GL", "").strip().lower()
    if asked in _LIBRARIES:
        return asked
    if asked:
        raise _rendering_error(f"the variable MUJOCO_GL is `{asked}`")
    found = offscreen_library()
    if found is None:
        raise _rendering_error("neither EGL nor OSMesa is installed")
    return found


def offscreen_library() -> str | None:
    """Return what draws without a screen on this system, a value of `MUJOCO_GL`, or None."""
    found = (name for name, shared in _SHARED_OBJECTS.items() if ctypes.util.find_library(shared))
    return next(found, None)


def _rendering_error(reason: str) -> RenderingError:
    reason = " ".join(reason.split())
    return RenderingError(
        f"pictures need a library that draws without a screen, but {reason}: install EGL (package "
        "libegl1 on Debian and Ubuntu) or OSMesa (libosmesa6), and set MUJOCO_GL to the one that "
        "is there (`egl`, `osmesa`) or not at all."
    )
