"""The chain: played returns against their closed forms."""

import math

import jax.numpy as jnp
import numpy as np
from playing import constant_agents, play

from maesn.envs import TaskSet
from maesn.envs.chain import LENGTH, Chain

GOALS = (28.0, 28.5, 29.7, 30.0)
TASKS = TaskSet(np.float32(GOALS))


def test_the_best_return_is_that_of_going_straight_ahead() -> None:
    for reward_kind in ("dense", "sparse"):
        env = Chain(reward_kind=reward_kind)
        cast = constant_agents(env, len(GOALS), 3.0, 1e-3)  # clipped: a full step
        found = play(env, TASKS, range(len(GOALS)), cast=cast).undiscounted_return[:, 0]
        dense = [LENGTH / goal for goal in GOALS]
        # Paid from the step that reaches the goal, number ceil(g), to the last one.
        sparse = [env.horizon + 1 - math.ceil(goal) for goal in GOALS]
        np.testing.assert_allclose(found, dense if reward_kind == "dense" else sparse, rtol=1e-5)


def test_walls_stand_at_both_ends() -> None:
    env = Chain()
    for mean, end in ((-3.0, 0.0), (3.0, LENGTH)):
        cast = constant_agents(env, 1, mean, 1e-3)
        episodes = play(env, TASKS, [0], cast=cast)
        np.testing.assert_allclose(LENGTH * episodes.observation[0, :, -1, 0], end, rtol=1e-6)


def test_chance_does_not_find_the_reward() -> None:
    env = Chain(reward_kind="sparse")
    cast = constant_agents(env, 1, 0.0, 1.0)
    episodes = play(env, TASKS, [0], episodes=2000, cast=cast)
    reached = LENGTH * np.asarray(episodes.observation).max()
    assert 12 < reached < 28
    assert not episodes.solved.any()


def test_figures_show_position_and_goal_on_one_axis() -> None:
    env = Chain()
    np.testing.assert_array_equal(env.position(jnp.full(1, 0.5)), [15.0, 0.0])
    np.testing.assert_array_equal(env.goal(jnp.float32(29.0)), [29.0, 0.0])


def test_elsewhere_another_number_may_be_paid_the_same_everywhere() -> None:
    env = Chain(reward_kind="sparse", pay_elsewhere=-1.0)
    straight = constant_agents(env, len(GOALS), 3.0, 1e-3)
    found = play(env, TASKS, range(len(GOALS)), cast=straight).undiscounted_return[:, 0]
    steps = np.ceil(GOALS)  # the last of them is the first that is paid
    np.testing.assert_allclose(found, (env.horizon - steps + 1) - (steps - 1), rtol=1e-6)
    lost = play(env, TASKS, [0], episodes=20, cast=constant_agents(env, 1, 0.0, 1.0))
    np.testing.assert_array_equal(lost.reward, -1.0)
    np.testing.assert_array_equal(lost.observed_reward, -1.0)
