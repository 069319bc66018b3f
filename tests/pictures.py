"""Whether pictures can be drawn on this machine, as MuJoCo's own renderer finds, not ours."""

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
    """Whether MuJoCo draws with the first of the libraries that we would take."""
    asked = (os.environ["MUJOCO_GL"],) if "MUJOCO_GL" in os.environ else ("egl", "osmesa")
    return any(_draws_with(library) for library in asked)


def _draws_with(library: str) -> bool:
    command = [sys.executable, "-c", _DRAW]
    environment = os.environ | {"MUJOCO_GL": library}
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
