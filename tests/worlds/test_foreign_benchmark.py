"""What the benchmark of foreign environments divides by has to play just what a collection does."""

from types import ModuleType
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from playing import agents, keys
from scripts import load_script
from strange_families import EPISODES, walkers
from strangers import HORIZON, draw_walks

from maesn.envs import TaskSet
from maesn.experience.episodes import Episodes
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

NUM_TASKS = 5


@pytest.fixture(scope="module")
def foreign() -> ModuleType:
    return load_script("benchmarks/foreign.py")


@pytest.fixture(scope="module")
def collected(foreign: ModuleType) -> tuple[Any, Episodes, dict[str, np.ndarray], Any]:
    """A world, episodes, the readings that they end with, and what it takes to play them again."""
    drawn = draw_walks(np.random.default_rng(0), NUM_TASKS)
    drawn[:3, 2:] = [[2, 1], [3, 2], [5, 0]]
    world = foreign.RecordingWorld(make_world(walkers.make_env(), TaskSet(drawn), 2))
    collector = Collector(world, EPISODES)
    cast, index = agents(world.env, NUM_TASKS), jnp.arange(NUM_TASKS)
    episodes, readings = collector.play(keys(NUM_TASKS), cast, index)
    world.close()
    last = {name: np.asarray(values[-1]) for name, values in readings.items()}
    return world, episodes, last, world.played(episodes)


def test_the_workers_alone_end_where_the_collection_does(
    foreign: ModuleType, collected: Any
) -> None:
    *_, last, played = collected
    workers = foreign.WorkersAlone(walkers.make_env(), 2)
    readings = workers.play(played)
    workers.close()
    assert readings.keys() == last.keys()
    for name, values in last.items():
        np.testing.assert_array_equal(readings[name], values, err_msg=name)


def test_the_environments_alone_end_where_the_collection_does(
    foreign: ModuleType, collected: Any
) -> None:
    *_, last, played = collected
    environments = foreign.EnvironmentsAlone(walkers.make_env())
    seen = [observation["place"] for observation in environments.play(played)]
    np.testing.assert_allclose(np.stack(seen), last["observation"][:, -2:], atol=1e-6)


def test_controls_of_ended_episodes_are_zero_though_their_actions_are_garbage(
    collected: Any,
) -> None:
    world, episodes, _, played = collected
    np.testing.assert_array_equal(played.lengths, episodes.valid.sum(-1).ravel())
    assert played.lengths[:EPISODES].tolist() == [2] * EPISODES
    assert played.lengths.max() == HORIZON
    for simulation, length in enumerate(played.lengths):
        assert played.controls[:length, simulation].any()
        assert not played.controls[length:, simulation].any()
    garbage = jnp.where(episodes.valid[..., None], episodes.action, jnp.nan)
    again = world.played(eqx.tree_at(lambda x: x.action, episodes, garbage))
    np.testing.assert_array_equal(again.controls, played.controls)
