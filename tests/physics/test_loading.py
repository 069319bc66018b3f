"""Reading models, and where MuJoCo's warnings go."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import mujoco
import pytest

from maesn.physics import load_model

PLAIN = "<mujoco><worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>"
DEPRECATED = PLAIN.replace("<mujoco>", "<mujoco><compiler settotalmass='3'/>")


@pytest.fixture
def own_handler() -> Iterator[list[str]]:
    previous = mujoco.get_mju_user_warning()
    heard: list[str] = []
    mujoco.set_mju_user_warning(heard.append)
    yield heard
    mujoco.set_mju_user_warning(previous)


def test_a_model_is_found_with_and_without_its_ending() -> None:
    assert load_model("wheeled").nq == load_model("wheeled.xml").nq == 6


def test_a_users_file_never_resets_itself(tmp_path: Path) -> None:
    path = tmp_path / "own.xml"
    path.write_text(PLAIN, encoding="utf-8")
    for given in (path, str(path)):
        model = load_model(given)
        assert model.nq == 1
        assert model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET


def test_a_model_may_be_xml_itself() -> None:
    model = load_model(f"\n  {PLAIN}")
    assert model.nq == 1
    assert model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET
    with pytest.raises(ValueError, match="XML"):
        load_model("<mujoco><worldbody/>")
    with pytest.warns(UserWarning, match=r"^model '<mujoco>': .*settotalmass"):
        load_model(DEPRECATED)


def test_an_unknown_model_names_the_known_ones() -> None:
    with pytest.raises(FileNotFoundError, match=r"wheeled\.xml.*got 'weeled'"):
        load_model("weeled")


def test_a_broken_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "broken.xml"
    path.write_text("<mujoco><worldbody/>", encoding="utf-8")
    with pytest.raises(ValueError, match="XML"):
        load_model(path)


def test_warnings_of_the_compiler_become_python_warnings(tmp_path: Path) -> None:
    path = tmp_path / "deprecated.xml"
    path.write_text(DEPRECATED, encoding="utf-8")
    with pytest.warns(UserWarning, match=r"deprecated\.xml.*settotalmass"):
        load_model(path)


def test_somebody_elses_handler_is_left_alone(tmp_path: Path, own_handler: list[str]) -> None:
    path = tmp_path / "deprecated.xml"
    path.write_text(DEPRECATED, encoding="utf-8")
    load_model(path)
    assert len(own_handler) == 1


def test_a_blow_up_writes_nothing_to_disk_or_terminal(tmp_path: Path) -> None:
    """In a fresh process, where nobody has listened to MuJoCo before."""
    program = """
import numpy as np
from maesn.physics import NativeSimulator
simulator = NativeSimulator("wheeled", 4, num_threads=2, nonfinite="report")
simulator.reset(np.zeros((4, 6)), np.full((4, 6), 9e9))
for _ in range(20):
    simulator.step(np.zeros((4, 2)))
assert simulator._batch.warning.any()
"""
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert not list(tmp_path.iterdir())
