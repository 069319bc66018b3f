"""The chain: played returns against their closed forms."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from chain import LENGTH, NEAREST, Chain
from playing import constant_agents, play

from maesn.envs import TaskSet

GOALS = (28.0, 28.5, 29.7, 30.0)
TASKS = TaskSet(np.float32(GOALS))


def test_the_best_return_is_that_of_going_straight_ahead() -> None:
    for reward_kind in ("dense", "sparse"):
        env = Chain(reward_kind=reward_kind)
        cast = constant_agents(env, len(GOALS), 3.0, 1e-3)  # clipped: a full step
        found = play(env, TASKS, range(len(GOALS)), cast=cast).undiscounted_return[:, 0]
        dense = [LENGTH / goal for goal in GOALS]
        # The reward comes from the step that reaches the goal, number ceil(g), to the last one.
        sparse = [env.horizon + 1 - math.ceil(goal) for goal in GOALS]
        np.testing.assert_allclose(found, dense if reward_kind == "dense" else sparse, rtol=1e-5)


def test_walls_stand_at_both_ends() -> None:
    env = Chain()
    for mean, end in ((-3.0, 0.0), (3.0, LENGTH)):
        cast = constant_agents(env, len(GOALS), mean, 1e-3)
        episodes = play(env, TASKS, range(len(GOALS)), cast=cast)
        np.testing.assert_allclose(LENGTH * episodes.observation[..., -1, 0], end, rtol=1e-6)


def test_chance_does_not_find_the_reward() -> None:
    env, episodes = Chain(), 2000
    advance = jax.jit(jax.vmap(env.advance))
    readings = {"qpos": jnp.zeros((episodes, 1)), "qvel": jnp.zeros((episodes, 1))}
    furthest = 0.0
    for noise in np.random.default_rng(0).standard_normal((env.horizon, episodes, 1)):
        readings = advance(readings, jnp.clip(jnp.asarray(noise, jnp.float32), -1.0, 1.0))
        furthest = max(furthest, float(readings["qpos"].max()))
    assert 12 < furthest < NEAREST


def test_figures_show_position_and_goal_on_one_axis() -> None:
    env = Chain()
    np.testing.assert_array_equal(env.position(jnp.full(1, 0.5)), [15.0, 0.0])
    np.testing.assert_array_equal(env.goal(jnp.float32(29.0)), [29.0, 0.0])


def test_elsewhere_the_reward_may_be_another_number_the_same_everywhere() -> None:
    env = Chain(reward_kind="sparse", reward_elsewhere=-1.0)
    straight = constant_agents(env, len(GOALS), 3.0, 1e-3)
    found = play(env, TASKS, range(len(GOALS)), cast=straight).undiscounted_return[:, 0]
    steps = np.ceil(GOALS)  # the last of them is the first with a reward
    np.testing.assert_allclose(found, (env.horizon - steps + 1) - (steps - 1), rtol=1e-6)
    lost = play(env, TASKS, range(len(GOALS)), cast=constant_agents(env, len(GOALS), 0.0, 1.0))
    np.testing.assert_array_equal(lost.reward, -1.0)
    np.testing.assert_array_equal(lost.observed_reward, -1.0)
