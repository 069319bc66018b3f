"""Probes: played returns against their closed forms."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from chain import LENGTH, Chain
from learning_problems.probes import (
    DelayedTarget,
    HiddenEnd,
    HiddenSide,
    HiddenTarget,
)
from playing import LATENT_SIZE, constant_agents, play
from scipy import stats

from maesn.context import Latent
from maesn.envs import AnyEnv, RewardKind, TaskSet
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.networks import MLP, Linear
from maesn.policies import GaussianMLPPolicy

EPISODES = 4000
RADIUS = 0.6
TARGETS = TaskSet(np.float32([[0.6, 0.8], [-1.0, 0.0]]))
SIDES = TaskSet(np.float32([-1.0, 1.0]))
SIGMAS = 5


def assert_mean(samples: np.ndarray, expected: float) -> None:
    """The mean of the samples is the expected one, within five standard errors."""
    error = np.std(samples) / math.sqrt(len(samples))
    assert abs(np.mean(samples) - expected) <= SIGMAS * error + 1e-6


def play_many(env: AnyEnv, tasks: TaskSet, cast: Agents) -> Episodes:
    """Many episodes in each of two tasks: one shape, so that each environment compiles once."""
    return play(env, tasks, [0, 1], episodes=EPISODES, cast=cast)


@pytest.mark.parametrize("env", [HiddenTarget(), DelayedTarget()])
def test_return_of_a_gaussian_on_a_target(env: AnyEnv) -> None:
    # E|a - g|^2 = |m - g|^2 + 2 s^2 with m = (0.3, 0.3), s = 0.5:
    #   g = (0.6, 0.8): 0.09 + 0.25 + 0.5 = 0.84;   g = (-1, 0): 1.69 + 0.09 + 0.5 = 2.28
    episodes = play_many(env, TARGETS, constant_agents(env, 2, 0.3, 0.5))
    returns = np.asarray(episodes.undiscounted_return)
    assert_mean(returns[0], -0.84)
    assert_mean(returns[1], -2.28)


@pytest.mark.parametrize("make_env", [HiddenTarget, DelayedTarget])
def test_sparse_return_of_a_gaussian_on_a_target(make_env: type) -> None:
    # X = |a - g|^2 / s^2 is noncentral chi-squared with 2 degrees of freedom and the noncentrality
    # |m - g|^2 / s^2. Within the radius the reward is -s^2 X, elsewhere -|g|^2 = -1.
    mean, std = (0.5, 0.5), 0.4
    env = make_env(reward_kind="sparse", sparse_radius=RADIUS)
    episodes = play_many(env, TARGETS, constant_agents(env, 2, jnp.array(mean), std))
    for task, target in enumerate(TARGETS.tasks):
        x = stats.ncx2(2, np.sum((mean - target) ** 2) / std**2)
        edge = RADIUS**2 / std**2
        inside = x.expect(lambda value: -(std**2) * value, ub=edge)
        assert_mean(np.asarray(episodes.undiscounted_return[task]), inside - x.sf(edge))
        assert_mean(np.asarray(episodes.solved[task, :, -1], float), x.cdf(edge))


def test_only_the_first_action_counts_and_is_rewarded_at_the_end() -> None:
    env = DelayedTarget()
    episodes = play_many(env, TARGETS, constant_agents(env, 2, 0.0, 1.0))
    first = np.asarray(episodes.action[:, :, 0])
    expected = np.zeros((2, EPISODES, env.horizon))
    expected[:, :, -1] = -np.sum((first - TARGETS.tasks[:, None]) ** 2, axis=-1)
    np.testing.assert_allclose(episodes.reward, expected, rtol=1e-5)
    # Observation: share of the episode, then the first action from the second state on.
    seen = np.asarray(episodes.observation)
    share = np.broadcast_to(np.arange(env.horizon + 1) / env.horizon, seen.shape[:-1])
    np.testing.assert_allclose(seen[..., 0], share, rtol=1e-6)
    np.testing.assert_array_equal(seen[:, :, 0, 1:], np.zeros_like(first))
    np.testing.assert_array_equal(seen[:, :, 1:, 1:], np.repeat(first[:, :, None], 10, axis=2))


@pytest.mark.parametrize("mean", [0.0, 0.8])
def test_without_a_latent_a_side_is_found_by_luck_alone(mean: float) -> None:
    # Steps are independent, to the right with p = Phi(mean / std): success p^T and (1 - p)^T; the
    # dense return is g E[x_T] = g (2 p - 1).
    env = HiddenSide(reward_kind="sparse")
    p = stats.norm.cdf(mean)
    cast = constant_agents(env, 2, mean, 1.0)
    sparse, dense = play_many(env, SIDES, cast), play_many(HiddenSide(), SIDES, cast)
    for task, (side, success) in enumerate(
        zip((-1, 1), ((1 - p) ** env.horizon, p**env.horizon), strict=True)
    ):
        found = np.asarray(sparse.undiscounted_return[task])
        assert stats.binomtest(int(found.sum()), EPISODES, success).pvalue > 1e-6
        np.testing.assert_array_equal(sparse.solved[task].any(-1), found)
        assert_mean(np.asarray(dense.undiscounted_return[task]), side * (2 * p - 1))


def coherent_agents(means: list[float], std: float) -> Agents:
    """Agents that step in the direction of the first component of z ~ N(mean, std^2)."""
    weight = jnp.zeros((1 + LATENT_SIZE, 1)).at[1, 0].set(1.0)
    policy = GaussianMLPPolicy(MLP((Linear(weight, jnp.zeros(1)),)), jnp.full(1, math.log(1e-6)))
    mean = jnp.stack([jnp.array(means), jnp.zeros(len(means))], axis=1)
    latent = Latent(mean, jnp.full((len(means), LATENT_SIZE), math.log(std)))
    return Agents(policy, latent, shares_policy=True)


def test_with_a_latent_every_side_is_found_in_half_of_the_episodes() -> None:
    env = HiddenSide(reward_kind="sparse")
    episodes = play_many(env, SIDES, coherent_agents([0.0, 0.0], 1.0))
    for task, side in enumerate((-1, 1)):
        returns = np.asarray(episodes.undiscounted_return[task])
        np.testing.assert_array_equal(returns, np.sign(episodes.z[task, :, 0]) == side)
        assert stats.binomtest(int(returns.sum()), EPISODES, 0.5).pvalue > 1e-6


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
