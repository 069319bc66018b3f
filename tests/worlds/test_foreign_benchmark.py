"""What the benchmark of foreign environments divides by has to play just what a collection does."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from playing import agents, assert_same, keys
from scripts import load_script
from strange_families import EPISODES, walkers
from strangers import draw_walks

from maesn.envs import TaskSet
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

NUM_TASKS = 5


def test_the_same_episodes_are_played_by_workers_and_by_environments_alone() -> None:
    foreign = load_script("benchmarks/foreign.py")
    drawn = draw_walks(np.random.default_rng(0), NUM_TASKS)
    drawn[:3, 2:] = [[2, 1], [3, 2], [5, 0]]
    env = walkers.make_env()
    world = foreign.RecordingWorld(make_world(env, TaskSet(drawn), 2))
    collector, index = Collector(world, EPISODES), jnp.arange(NUM_TASKS)
    episodes, readings = collector.play(keys(NUM_TASKS), agents(env, NUM_TASKS), index)
    world.close()
    last = {name: np.asarray(values[-1]) for name, values in readings.items()}
    # What the policy asks for after the end of an episode is garbage, and reaches nobody.
    garbage = jnp.where(episodes.valid[..., None], episodes.action, jnp.nan)
    played = world.played(eqx.tree_at(lambda x: x.action, episodes, garbage))
    np.testing.assert_array_equal(played.lengths, episodes.valid.sum(-1).ravel())
    for simulation, length in enumerate(played.lengths):
        assert played.controls[:length, simulation].any()
        assert not played.controls[length:, simulation].any()
    workers, alone = foreign.WorkersAlone(env, 2), foreign.EnvironmentsAlone(env)
    assert_same(workers.play(played), last)
    workers.close()
    seen = [observation["place"] for observation in alone.play(played)]
    np.testing.assert_allclose(np.stack(seen), last["observation"][:, -2:], atol=1e-6)
