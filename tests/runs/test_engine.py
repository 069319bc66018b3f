"""The engine of a run: chosen, recorded, and kept apart from others."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from small_runs import create, finish, metrics, tiny_maesn

from maesn import api
from maesn.physics import EngineError
from maesn.runs.config import CONFIG
from maesn.storage import RunError


def test_the_engine_of_a_run_is_recorded(tmp_path: Path) -> None:
    run = create(tmp_path / "run", family="wheeled", engine="mjx")
    config = json.loads((run.directory / CONFIG).read_text())
    assert (config["engine"], config["settings"]["engine"]) == ("mujoco.mjx", "mjx")
    assert "mujoco-mjx" in config["versions"]


def test_an_engine_that_cannot_move_the_family_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="`engine` must be"):
        create(tmp_path / "run", family="point", engine="mjx")
    assert not (tmp_path / "run").exists()


def test_a_missing_engine_leaves_no_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(EngineError, match=r"pip install -e '\.\[gpu\]'"):
        create(tmp_path / "run", family="wheeled", engine="mjx")
    assert not (tmp_path / "run").exists()


@pytest.mark.long
def test_a_meta_iteration_on_mjx(tmp_path: Path) -> None:
    learner = tiny_maesn(meta_batch_size=2)
    run = create(
        tmp_path / "run", learner, family="wheeled", engine="mjx", episodes_per_task=2, iterations=1
    )
    (line,) = metrics(finish(run))
    assert all(math.isfinite(value) for value in line.values())
    assert line["outer/accepted"] == 1
    assert line["return_before"] < -50  # 200 steps at about 2 m from the goal

    tasks = tmp_path / "tasks.npz"
    # As many tasks as in training, so that the world's program is compiled once.
    angles = np.linspace(0, np.pi, 2)
    np.savez(tasks, goal=np.float32(2 * np.stack([np.cos(angles), np.sin(angles)], axis=1)))
    settings = {"episodes": 0, "episodes_per_update": 2, "tasks": str(tasks), "reward": "dense"}
    own = api.adapt(run, **settings)
    native = api.adapt(run, **settings, engine="native")
    np.testing.assert_allclose(own.curves.mean_return, native.curves.mean_return, atol=0.5)
    # Single precision against double: the means differ in their last digits.
    assert (own.curves.mean_return != native.curves.mean_return).any()
    names = [path.name for path in (run.directory / "adaptation").glob("*.csv")]
    # Between them stands the digest of the tasks.
    assert {name[:11] + name[17:] for name in names} == {
        "file-tasks--dense-with-0-episodes-2-per-update.csv",
        "file-tasks--on-native-dense-with-0-episodes-2-per-update.csv",
    }
