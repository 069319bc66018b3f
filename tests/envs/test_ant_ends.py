"""Ants whose physics blows up: their episodes end there, and nothing else notices."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from playing import agents, assert_same, play

from maesn.axes import Key
from maesn.envs import Ant, Variant, ant
from maesn.experience.episodes import Episodes

TASKS = ant.task_set("training", size=4)
EPISODES, HORIZON = 6, 8
SPEED = 1e3  # rad/s, up in one joint and down in the next
LARGEST_SEEN = 10.0  # more than what the other ants do
SWING = SPEED * jnp.concatenate([jnp.zeros(6), jnp.resize(jnp.array([1.0, -1.0]), 8)])


class Bursting(Ant):
    """Starts about half of its episodes with legs that whirl far beyond what the engine can do."""

    def initial(self, key: Key, task: Any) -> tuple[jax.Array, jax.Array]:
        qpos, qvel = super().initial(key, task)
        return qpos, qvel + jnp.where(jax.random.bernoulli(jax.random.fold_in(key, 1)), SWING, 0.0)

    def observe(self, readings: Any) -> jax.Array:
        """Clipped (NaN stays NaN), so that a policy is not moved most by what it sees there."""
        return jnp.clip(super().observe(readings), -LARGEST_SEEN, LARGEST_SEEN)


def burst(episodes: Episodes) -> np.ndarray:
    """Which episodes started that way."""
    return np.abs(np.asarray(episodes.observation[:, :, 0, 28])) == LARGEST_SEEN


@pytest.mark.parametrize("variant", ["reference", "paper"])
def test_an_ant_that_blows_up_ends_its_episode_and_no_other(variant: Variant) -> None:
    settings = {"variant": variant, "horizon": HORIZON}
    wild, calm = (
        play(env, TASKS, [1, 3], episodes=EPISODES, cast=agents(env, 2))
        for env in (Bursting(**settings), Ant(**settings))
    )
    lost = burst(wild)
    assert 0 < lost.sum() < lost.size
    np.testing.assert_array_equal(wild.terminated, lost)
    np.testing.assert_array_equal(wild.valid.all(-1), ~lost)
    assert np.all(wild.valid[..., 0])
    # What is valid is a number; what follows is none.
    for values in (wild.reward, wild.goal_reward):
        assert np.isfinite(np.asarray(values)[np.asarray(wild.valid)]).all()
    assert np.isfinite(wild.undiscounted_return).all()
    assert np.isnan(np.asarray(wild.observation)[lost, -1, :15]).all()
    assert np.isnan(np.asarray(wild.action)[lost, -1]).all()
    assert not np.asarray(wild.solved & ~wild.valid).any()
    # The other ants walk as if they were alone.
    alive = [jax.tree.map(lambda leaf: np.asarray(leaf)[~lost], x) for x in (wild, calm)]
    assert_same(alive[0], alive[1])
