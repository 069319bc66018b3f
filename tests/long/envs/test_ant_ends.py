"""MAESN learns from the ants that live, whatever follows the end of the others."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from envs.test_ant_ends import EPISODES, HORIZON, TASKS, Bursting
from playing import assert_same

from maesn.experience.episodes import Episodes
from maesn.learners import Problem
from maesn.learners.gradient.outer import TrustRegionOuterStep
from maesn.learners.presets import maesn
from maesn.policies import GaussianMLP
from maesn.worlds import make_world
from maesn.worlds.collector import Collector


class Replacing:
    """A collector that puts something else behind the ends of episodes."""

    def __init__(self, collect: Collector, garbage: float) -> None:
        self.collect, self.garbage = collect, garbage
        self.num_tasks, self.episodes_per_task = collect.num_tasks, collect.episodes_per_task
        self.dead = 0

    def __call__(self, *arguments: Any, **named: Any) -> Episodes:
        episodes = self.collect(*arguments, **named)
        self.dead += int(jnp.sum(episodes.terminated))
        steps = [episodes.action, episodes.reward, episodes.goal_reward, episodes.behaviour]
        steps = jax.tree.map(lambda x: self._replace(x, episodes.valid), steps)
        # The state that an episode ends in belongs to it only if it is finite; nobody reads it.
        seen = self._replace(episodes.observation[:, :, :-1], episodes.valid)
        end = jnp.where(
            episodes.terminated[..., None], self.garbage, episodes.observation[:, :, -1]
        )
        return Episodes(
            **vars(episodes)
            | dict(zip(("action", "reward", "goal_reward", "behaviour"), steps, strict=True))
            | {"observation": jnp.concatenate([seen, end[:, :, None]], axis=2)}
        )

    def _replace(self, values: jax.Array, valid: jax.Array) -> jax.Array:
        mask = valid.reshape(*valid.shape, *[1] * (values.ndim - valid.ndim))
        return jnp.where(mask, values, self.garbage)


def test_maesn_learns_from_the_ants_that_live() -> None:
    env = Bursting(horizon=HORIZON)
    # Every step counts for the curvature: of an episode that dies at once there is only the first.
    learner = maesn(
        meta_batch_size=2, policy=GaussianMLP((8,)), outer=TrustRegionOuterStep(curvature_stride=1)
    )
    state = learner.init(
        jax.random.key(0), Problem(env.observation_size, env.action_size, len(TASKS))
    )
    collect = Collector(make_world(env, TASKS), EPISODES)
    after, info = learner.step(jax.random.key(1), state, collect)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((after, info)))
    assert info.nonfinite_tasks == 0
    for garbage in (0.0, 1e30):
        replaced = Replacing(collect, garbage)
        assert_same(learner.step(jax.random.key(1), state, replaced), (after, info))
        assert replaced.dead > 0
    assert info.outer.accepted
