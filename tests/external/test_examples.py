"""The example of a foreign family, with an earlier MuJoCo than the library's own engine needs.

`make test-external` runs these.
"""

import csv
import importlib.util
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from playing import constant_agents, keys

from maesn.cli import run as maesn
from maesn.envs import TaskFamily
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"

sys.path.insert(0, str(EXAMPLES))
family: TaskFamily = importlib.import_module("half_cheetah_velocity").family


def test_episodes_repeat_and_tasks_differ() -> None:
    env = family.make_env()
    tasks = family.task_set("test", 2)
    world = make_world(env, tasks, num_threads=2)
    collect, cast = Collector(world, 2), constant_agents(env, 2, 0.3, 0.1)
    first = collect(keys(2), cast, jnp.arange(2))
    again = collect(keys(2), cast, jnp.arange(2))
    jax.tree.map(np.testing.assert_array_equal, first, again)
    swapped = collect(keys(2), cast, jnp.array([1, 0]))
    assert not np.allclose(first.reward, swapped.reward)
    world.close()


def test_the_cheetah_is_rewarded_for_its_target() -> None:
    env, speed = family.make_env(), family.task_set("test", 1)
    collect = Collector(make_world(env, speed), 2)
    episodes = collect(keys(1), constant_agents(env, 1, 0.3, 0.1), jnp.zeros(1, int))
    # Component 8 of the observation is the speed after the step; the reward is for the mean speed
    # over it, so the two agree over an episode, not at each step.
    controls = np.clip(episodes.action, -1, 1)
    error = -np.asarray(episodes.reward) - 0.1 * (controls**2).sum(-1)
    seen = np.abs(np.asarray(episodes.observation)[..., 1:, 8] - float(speed[0]))
    assert np.corrcoef(error.ravel(), seen.ravel())[0, 1] > 0.9


def test_the_documented_commands(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    named = ["--family", "half_cheetah_velocity:family"]
    small = ["--meta-batch-size", "2", "--episodes-per-task", "2", "--policy.hidden-sizes", "8"]
    train = ["train", "maesn", "--run", "run", "--iterations", "1", *small, *named]
    assert maesn(train) == 0
    assert maesn(["resume", "run", "--iterations", "2", *named]) == 0
    np.savez("few.npz", **{family.task_names[0]: family.task_set("test", 2).tasks})
    adapt = ["adapt", "run", "--tasks", "few.npz", "--episodes", "2", "--episodes-per-update", "2"]
    assert maesn([*adapt, "--out", "table.csv", *named]) == 0
    with Path("table.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 4
    assert maesn(["export", "run", "policy.npz", *named]) == 0
