"""Probes: played returns against their closed forms."""

import numpy as np
import pytest
from chain import LENGTH, Chain
from learning_problems.probes import HiddenEnd
from playing import constant_agents, play

from maesn.envs import RewardKind, TaskSet

GOALS = (28.0, 28.5, 29.7, 30.0)


def test_the_best_return_of_the_chain_is_that_of_going_straight_ahead() -> None:
    tasks, steps = TaskSet(np.float32(GOALS)), np.ceil(GOALS)  # the last one is the first rewarded
    for settings, expected in (
        ({}, LENGTH / np.array(GOALS)),
        ({"reward_kind": "sparse"}, 50 - steps + 1),
        ({"reward_kind": "sparse", "reward_elsewhere": -1.0}, (50 - steps + 1) - (steps - 1)),
    ):
        env = Chain(**settings)
        cast = constant_agents(env, len(GOALS), 3.0, 1e-3)  # clipped: a full step
        found = play(env, tasks, range(len(GOALS)), cast=cast).undiscounted_return[:, 0]
        np.testing.assert_allclose(found, expected, rtol=1e-5)
    lost = play(env, tasks, range(len(GOALS)), cast=constant_agents(env, len(GOALS), 0.0, 1.0))
    np.testing.assert_array_equal(lost.reward, -1.0)
    np.testing.assert_array_equal(lost.observed_reward, -1.0)


LIFETIMES = {0.2: 1, 1.0: 1, 1.5: 2, 2.5: 3, 4.0: 4, 9.5: 10, 10.0: 10, 11.0: 10}


@pytest.mark.parametrize("reward_kind", ["dense", "sparse"])
def test_lifetimes_are_counted_in_whole_steps(reward_kind: RewardKind) -> None:
    env, tasks = HiddenEnd(reward_kind=reward_kind), TaskSet(np.float32([*LIFETIMES]))
    episodes = play(env, tasks, np.arange(len(LIFETIMES)), episodes=2)
    steps = np.array([*LIFETIMES.values()])
    ends = np.array([*LIFETIMES]) <= env.horizon
    expected = steps if reward_kind == "dense" else ends
    np.testing.assert_array_equal(episodes.undiscounted_return, np.stack([expected] * 2, axis=1))
    np.testing.assert_array_equal(episodes.valid.sum(-1), np.stack([steps] * 2, axis=1))
    np.testing.assert_array_equal(episodes.terminated, np.stack([ends] * 2, axis=1))
    np.testing.assert_array_equal(episodes.solved.sum(-1), np.stack([ends] * 2, axis=1))
    # After the end nothing is a number; the state in which it ends is, for bootstrapping.
    for task, lived in enumerate(steps):
        alive = np.tile(np.arange(env.horizon + 1) <= lived, (2, 1))
        np.testing.assert_array_equal(np.isfinite(episodes.reward[task]), alive[:, 1:])
        np.testing.assert_array_equal(np.isfinite(episodes.observation[task, :, :, 0]), alive)
