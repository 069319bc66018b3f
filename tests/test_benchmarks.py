"""Benchmarks: they run, and the engine alone does just what a collection asks of it."""

import csv
import gzip
import importlib
import re
from itertools import product
from pathlib import Path
from typing import Any

import bare_physics
import bonus_control
import jax
import jax.numpy as jnp
import memory_control
import numpy as np
import pytest
from carts import MOTOR, CartTask, cart_on
from playing import constant_agents, keys

from maesn.envs import AbstractMujocoEnv, Ant, BlockPush, TaskSet, Wheeled, find_family
from maesn.experience.agent import TrialState
from maesn.worlds import make_world
from maesn.worlds.collector import Collector


class FallenAnt(Ant):
    """An ant that may start too low, so that its episode has ended before it begins."""

    def initial(self, key: jax.Array, task: jax.Array) -> tuple[jax.Array, jax.Array]:
        qpos, qvel = Ant().initial(key, task)
        return qpos.at[2].set(jnp.where(jax.random.bernoulli(key), 0.19, 0.55)), qvel


ENVS = (Wheeled(horizon=15), FallenAnt(horizon=15), BlockPush(horizon=15))


def played_twice(env: AbstractMujocoEnv[Any], tasks: TaskSet) -> Any:
    """Last readings of a collection, and of the engine alone; and the episodes."""
    collector = Collector(make_world(env, tasks, num_threads=1), 2)
    record = bare_physics.Recorder(collector)
    cast = constant_agents(env, 3, 0.5, 0.5)
    episodes = record(keys(3), cast, jnp.array([2, 0, 1]))
    _, readings = collector.play(keys(3), cast, jnp.array([2, 0, 1]))
    alone = bare_physics.BarePhysics(env, 6).play(*record.played())
    last = {name: values[-1] for name, values in readings.items()}
    return last, {name: values.astype(np.float32) for name, values in alone.items()}, episodes


@pytest.mark.parametrize("env", ENVS, ids=lambda env: env.name)
def test_the_engine_alone_ends_where_the_collection_does(env: AbstractMujocoEnv[Any]) -> None:
    tasks = find_family(env.name).task_set("training", 3)
    collected, alone, episodes = played_twice(env, tasks)
    assert collected.keys() == alone.keys() == set(env.readings)
    for name, values in collected.items():
        np.testing.assert_array_equal(values, alone[name], err_msg=name)
    # So that controls after an end are compared as well.
    assert len(np.unique(episodes.valid)) == (2 if env.name == "ant" else 1)


def test_tasks_that_change_the_dynamics_do_so_there_as_well(tmp_path: Path) -> None:
    tasks = TaskSet(CartTask(np.float32([0.0, 5.0, 0.0]), np.float32([1.0, 2.0, 8.0])))
    collected, alone, _ = played_twice(cart_on(tmp_path, MOTOR)(force=3.0), tasks)
    np.testing.assert_array_equal(collected["qvel"], alone["qvel"])
    assert len(np.unique(alone["qvel"])) >= 3


LINES: dict[str, tuple[dict[str, Any], str, int]] = {
    # Settings, and the lines that are printed: their form and number.
    "collection": (
        {"families": ("wheeled", "blockpush"), "num_tasks": 2, "episodes_per_task": 2}
        | {"repetitions": 1},
        r"^(?:wheeled|blockpush) ratio: \d+\.\d\d$",
        2,
    ),
    "meta_iteration": (
        {"meta_batch_size": 2, "episodes_per_task": 2, "iterations": 1},
        r"^meta-iteration .*\d",
        1,
    ),
    "methods": (
        {"methods": ("maesn", "pearl"), "scratch": ("reinforce",), "tasks": 2, "meta_episodes": 2}
        | {"scratch_episodes": 2, "repetitions": 1},
        r"^(?:maesn|pearl|reinforce)(?: +\d+\.\d+){7}$",
        3,
    ),
    "outer_step_peers": (
        {"tasks": 2, "episodes": 2, "repetitions": 1},
        r"^ +\d+\.\d\d s  maesn(?:, its own defaults)?$",
        2,
    ),
    "vime_chain": (
        {"seeds": 1, "tasks": 2, "updates": 1, "episodes_per_task": 2},
        r"^(?:trpo|reinforce|random_bonus|vime)\t0\t2\t",
        4,
    ),
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n == "collection" else [pytest.mark.long]) for n in LINES]
)
def test_every_line_is_printed(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    settings, form, number = LINES[name]
    script = importlib.import_module(name)
    script.main(script.Settings(**settings))
    printed = capsys.readouterr().out
    assert len(re.findall(form, printed, re.MULTILINE)) == number, printed


def test_memories_are_exchanged_among_tasks() -> None:
    hidden = jnp.array([[[1.0], [3.0]], [[5.0], [7.0]]])
    own = TrialState(hidden, action=10 * hidden, reward=hidden[..., 0])
    memories = memory_control.exchanged(own)
    assert memories["its own memory"] is own
    expected = {"nothing": [0, 0, 0, 0], "another task's": [5, 7, 1, 3], "the mean of all": [4] * 4}
    for name, values in expected.items():
        found = memories[name]
        np.testing.assert_array_equal(found.recurrent_state.ravel(), values)
        np.testing.assert_array_equal(found.action.ravel(), 10 * np.array(values))
        np.testing.assert_array_equal(found.reward.ravel(), values)


@pytest.mark.long
def test_random_bonuses_are_the_control_of_curiosity(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = {"num_tasks": 2, "updates": 2, "episodes_per_task": 3, "weight": 1.0}
    bonus_control.main(bonus_control.Settings(family="point", **options, out=tmp_path))
    assert re.findall(r"^(\w+) +after 2 updates", capsys.readouterr().out, re.M) == [
        "random_bonus",
        "vime",
    ]
    returns = {}
    for name in ("random_bonus", "vime"):
        with gzip.open(tmp_path / f"{name}.csv.gz", "rt", newline="") as file:
            rows = list(csv.DictReader(file))
        assert [(row["task"], row["update"]) for row in rows] == [*product("01", "012")]
        returns[name] = [float(row["mean_return"]) for row in rows]
    # The first update has no bonus. From the second one on they have it for different steps.
    same = np.equal(returns["random_bonus"], returns["vime"])
    assert same.tolist() == [True, True, False] * 2
