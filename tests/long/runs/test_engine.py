"""A meta-iteration on the accelerator's engine, and adaptation on either engine."""

import math
from pathlib import Path

import numpy as np
from small_runs import create, finish, metrics, tiny_maesn

from maesn import api


def test_a_meta_iteration_on_mjx(tmp_path: Path) -> None:
    learner = tiny_maesn(meta_batch_size=2)
    run = create(
        tmp_path / "run", learner, family="wheeled", engine="mjx", episodes_per_task=2, iterations=1
    )
    (line,) = metrics(finish(run))
    assert all(math.isfinite(value) for value in line.values())
    assert line["trust_region/accepted"] == 1
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
        "file-tasks--dense.csv",
        "file-tasks--dense-on-native.csv",
    }
