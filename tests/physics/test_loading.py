"""Reading models, and where MuJoCo's warnings go."""

import subprocess
import sys
from pathlib import Path

import mujoco
import pytest

from maesn.physics import load_model

PLAIN = "<mujoco><worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>"
DEPRECATED = PLAIN.replace("<mujoco>", "<mujoco><compiler settotalmass='3'/>")


@pytest.mark.parametrize("kind", ["path", "text of a path", "XML"])
def test_a_users_model_never_resets_itself_and_warnings_are_pythons(
    kind: str, tmp_path: Path
) -> None:
    def given(xml: str) -> str | Path:
        path = tmp_path / "own.xml"
        path.write_text(xml, encoding="utf-8")
        return {"path": path, "text of a path": str(path), "XML": f"\n  {xml}"}[kind]

    model = load_model(given(PLAIN))
    assert model.nq == 1
    assert model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET
    with pytest.raises(ValueError, match="XML"):
        load_model(given("<mujoco><worldbody/>"))
    named = "<mujoco>" if kind == "XML" else r"own\.xml"
    with pytest.warns(UserWarning, match=f"^model '.*{named}': .*settotalmass"):
        load_model(given(DEPRECATED))


def test_a_model_is_found_by_its_name() -> None:
    assert load_model("wheeled").nq == load_model("wheeled.xml").nq == 6
    with pytest.raises(FileNotFoundError, match=r"wheeled\.xml.*got 'weeled'"):
        load_model("weeled")


def test_somebody_elses_handler_is_left_alone() -> None:
    previous, heard = mujoco.get_mju_user_warning(), []
    mujoco.set_mju_user_warning(heard.append)
    try:
        load_model(DEPRECATED)
    finally:
        mujoco.set_mju_user_warning(previous)
    assert len(heard) == 1


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
