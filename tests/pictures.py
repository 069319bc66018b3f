"""Whether pictures can be drawn on this machine, as MuJoCo's own renderer finds, not ours."""

import ctypes.util
import functools
import os
import subprocess
import sys
from collections.abc import Callable
from typing import TypeVar

import pytest

from maesn.physics import RenderingError

T = TypeVar("T")

_DRAW = """
import mujoco
mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8).render()
"""


@functools.cache
def can_draw() -> bool:
    """Whether MuJoCo draws with EGL, or with OSMesa where there is no EGL, or as MUJOCO_GL says."""
    there = "egl" if ctypes.util.find_library("EGL") else "osmesa"
    environment = {"MUJOCO_GL": there} | os.environ
    command = [sys.executable, "-c", _DRAW]
    return not subprocess.run(command, env=environment, capture_output=True, check=False).returncode


def drawn(draw: Callable[[], T]) -> T | None:
    """Return what is drawn; None on a machine that cannot, where a sentence must say so."""
    if can_draw():
        return draw()
    with pytest.raises(RenderingError) as caught:
        draw()
    assert_says_what_to_install(str(caught.value))
    return None


def assert_says_what_to_install(sentence: str) -> None:
    """Check that a refusal is one sentence that helps."""
    assert "libegl1" in sentence
    assert "libosmesa6" in sentence
    assert "\n" not in sentence.strip()
