"""What all models of the library have in common."""

import mujoco
import pytest
from physics.robots import ROBOTS, text_of, without_looks


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_file_itself_switches_automatic_resets_off(robot: str) -> None:
    text = text_of(robot)
    flags = mujoco.MjModel.from_xml_string(text).opt.disableflags
    assert flags & mujoco.mjtDisableBit.mjDSBL_AUTORESET
    assert "settotalmass" not in text


@pytest.mark.parametrize("robot", ROBOTS)
def test_what_is_left_without_looks_cannot_be_seen(robot: str) -> None:
    bare = without_looks(robot)
    assert (bare.nsite, bare.nmocap, bare.nmat, bare.ncam, bare.nlight) == (0, 0, 0, 0, 0)
