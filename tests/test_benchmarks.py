"""Benchmarks: they run, and the engine alone does just what a collection asks of it."""

import re
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from carts import MOTOR, CartTask, cart_on
from playing import constant_agents, keys
from scripts import ROOT, load_script

from maesn.envs import AbstractMujocoEnv, Ant, BlockPush, TaskSet, Wheeled, find_family
from maesn.experience.trial_state import TrialState
from maesn.worlds import make_world
from maesn.worlds.collector import Collector


class FallenAnt(Ant):
    """An ant that may start too low, so that its episode has ended before it begins."""

    def initial(self, key: jax.Array, task: jax.Array) -> tuple[jax.Array, jax.Array]:
        qpos, qvel = Ant().initial(key, task)
        return qpos.at[2].set(jnp.where(jax.random.bernoulli(key), 0.19, 0.55)), qvel


ENVS = (Wheeled(horizon=15), FallenAnt(horizon=15), BlockPush(horizon=15))


@pytest.fixture(scope="module")
def bare_physics() -> ModuleType:
    return load_script("benchmarks/bare_physics.py")


def played_twice(bare_physics: ModuleType, env: AbstractMujocoEnv[Any], tasks: TaskSet) -> Any:
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
def test_the_engine_alone_ends_where_the_collection_does(
    bare_physics: ModuleType, env: AbstractMujocoEnv[Any]
) -> None:
    tasks = find_family(env.name).task_set("training", 3)
    collected, alone, episodes = played_twice(bare_physics, env, tasks)
    assert collected.keys() == alone.keys() == set(env.readings)
    for name, values in collected.items():
        np.testing.assert_array_equal(values, alone[name], err_msg=name)
    # So that controls after an end are compared as well.
    assert len(np.unique(episodes.valid)) == (2 if env.name == "ant" else 1)


def test_tasks_that_change_the_dynamics_do_so_there_as_well(
    bare_physics: ModuleType, tmp_path: Path
) -> None:
    tasks = TaskSet(CartTask(np.float32([0.0, 5.0, 0.0]), np.float32([1.0, 2.0, 8.0])))
    collected, alone, _ = played_twice(bare_physics, cart_on(tmp_path, MOTOR)(force=3.0), tasks)
    np.testing.assert_array_equal(collected["qvel"], alone["qvel"])
    assert len(np.unique(alone["qvel"])) >= 3


def test_every_family_gets_its_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    collection = load_script("benchmarks/collection.py")
    names = ("wheeled", "blockpush")
    collection.main(
        collection.Settings(families=names, num_tasks=2, episodes_per_task=2, repetitions=1)
    )
    printed = capsys.readouterr().out
    assert re.findall(r"^(\w+) ratio: \d+\.\d\d$", printed, re.MULTILINE) == list(names)


def test_memories_are_exchanged_among_tasks() -> None:
    control = load_script("benchmarks/memory_control.py")
    hidden = jnp.array([[[1.0], [3.0]], [[5.0], [7.0]]])
    own = TrialState(hidden, action=10 * hidden, reward=hidden[..., 0])
    memories = control.exchanged(own)
    assert memories["its own memory"] is own
    expected = {"nothing": [0, 0, 0, 0], "another task's": [5, 7, 1, 3], "the mean of all": [4] * 4}
    for name, values in expected.items():
        found = memories[name]
        np.testing.assert_array_equal(found.recurrent_state.ravel(), values)
        np.testing.assert_array_equal(found.action.ravel(), 10 * np.array(values))
        np.testing.assert_array_equal(found.reward.ravel(), values)
