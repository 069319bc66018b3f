"""Trials: episodes joined behind each other are what the policy lived through."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bernoulli_bandit import Bandit
from learning_problems.probes import HiddenEnd
from playing import keys

from maesn.axes import ObservedReward
from maesn.context import Nothing
from maesn.envs import Point, TaskSet, point
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.inner.surrogate import action_distributions
from maesn.learners.trials import Trials, join_episodes
from maesn.numerics import Categorical, DiagonalGaussian
from maesn.policies import Recurrent, RecurrentPolicy
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

HORIZON, SLOTS, EPISODES = 6, 2, 3
LIFETIMES = np.float32([3, 5])


def mortal() -> Collector:
    """Episodes of 3 and of 5 steps, and NaN afterwards."""
    return Collector(make_world(HiddenEnd(horizon=HORIZON), TaskSet(LIFETIMES)), EPISODES)


def recurrent(collect: Collector, observed: ObservedReward = "own") -> RecurrentPolicy:
    env = collect.world.env
    settings = Recurrent(env.action_kind, (), 4, (3,), observed_reward=observed)
    policy = settings.init(jax.random.key(0), env.observation_size, env.action_size, 0)
    # Readouts start close to 0, where mistakes would not be seen.
    return jax.tree.map(lambda x: x + 0.3 * jnp.sin(jnp.arange(x.size).reshape(x.shape)), policy)


def play_trial(collect: Collector, policy: RecurrentPolicy, length: int = 3) -> list[Episodes]:
    played = list[Episodes]()
    for number in range(length):
        trial_state = played[-1].trial_end if played else None
        agents = Agents(policy, Nothing(), shares_policy=True, trial_state=trial_state)
        played.append(collect(keys(SLOTS, number), agents, jnp.arange(SLOTS)))
    return played


distributions = eqx.filter_jit(Trials.distributions)
join = jax.jit(join_episodes)


def means_played(episodes: Sequence[Episodes]) -> np.ndarray:
    """`[trial, time, action]`, 0 where invalid."""
    parts = []
    for one in episodes:
        assert isinstance(one.behaviour, DiagonalGaussian)
        mean = np.where(np.asarray(one.valid)[..., None], one.behaviour.mean, 0.0)
        parts.append(mean.reshape(-1, *mean.shape[2:]))
    return np.concatenate(parts, axis=1)


@pytest.fixture(scope="module", params=["hidden_end", "point"])
def played(request: pytest.FixtureRequest) -> tuple[RecurrentPolicy, list[Episodes]]:
    worlds = {
        "hidden_end": mortal,
        "point": lambda: Collector(
            make_world(Point(horizon=HORIZON), point.task_set("training")), EPISODES
        ),
    }
    collect = worlds[request.param]()
    policy = recurrent(collect)
    return policy, play_trial(collect, policy)


def test_replaying_a_trial_gives_what_was_played(
    played: tuple[RecurrentPolicy, list[Episodes]],
) -> None:
    """Across episodes, across gaps, and from the start of the trial."""
    policy, episodes = played
    trials = join(episodes)
    again = distributions(trials, policy)
    assert isinstance(again, DiagonalGaussian)
    assert trials.valid.shape == (SLOTS * EPISODES, 3 * HORIZON)
    mean = np.where(np.asarray(trials.valid)[..., None], again.mean, 0.0)
    np.testing.assert_allclose(mean, means_played(episodes), rtol=1e-3, atol=1e-5)
    # The later episodes are played from memory: forgetting it would give something else.
    alone = distributions(join(episodes[1:]), policy)
    assert isinstance(alone, DiagonalGaussian)
    forgetful = np.where(np.asarray(trials.valid[:, HORIZON:])[..., None], alone.mean, 0.0)
    assert np.abs(forgetful - means_played(episodes)[:, HORIZON:]).max() > 0.01


def test_losses_replay_one_episode_from_the_memory_that_it_began_with(
    played: tuple[RecurrentPolicy, list[Episodes]],
) -> None:
    policy, episodes = played
    agents = Agents(policy, Nothing(), shares_policy=True)
    again = jax.jit(lambda one: agents.map(action_distributions, one, one.z))(episodes[2])
    assert isinstance(again, DiagonalGaussian)
    mean = np.where(np.asarray(episodes[2].valid)[..., None], again.mean, 0.0)
    mean = mean.reshape(-1, *mean.shape[2:])
    np.testing.assert_allclose(mean, means_played(episodes[2:]), rtol=1e-3, atol=1e-5)


def test_trials_are_independent_and_start_without_memory() -> None:
    collect = mortal()
    policy = recurrent(collect)
    first, second = play_trial(collect, policy, 1), play_trial(collect, policy, 1)
    assert first[0].trial_start is not None
    for leaf in jax.tree.leaves(first[0].trial_start):
        np.testing.assert_array_equal(leaf, np.zeros_like(leaf))
    jax.tree.map(np.testing.assert_array_equal, first[0].behaviour, second[0].behaviour)


def test_gradients_ignore_what_follows_the_end() -> None:
    collect = mortal()
    policy = recurrent(collect)
    episodes = play_trial(collect, policy, 2)
    assert np.isnan(np.asarray(episodes[0].reward)).any()

    def loss(varied: RecurrentPolicy, trials: Trials) -> jax.Array:
        log_prob = trials.distributions(varied).log_prob(trials.action)
        return jnp.where(trials.valid, log_prob, 0.0).sum()

    trials = join(episodes)
    gradient = jax.jit(jax.grad(loss))(policy, trials)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
    assert not np.isnan(np.asarray(trials.reward)).any()


def test_discrete_actions_are_one_hot_and_told_as_they_are() -> None:
    bandit = Collector(make_world(Bandit(), TaskSet(np.float32([[0, 0, 0, 1, 1]] * 2))), EPISODES)
    (episodes,) = play_trial(bandit, recurrent(bandit), 1)
    assert isinstance(episodes.behaviour, Categorical)
    assert set(np.unique(episodes.action)) == {0.0, 1.0}
    np.testing.assert_array_equal(episodes.action.sum(-1), 1.0)
    np.testing.assert_array_equal(episodes.reward, episodes.action[..., 3:].sum(-1))
    inputs = jax.jit(Episodes.policy_inputs)(episodes)
    np.testing.assert_array_equal(inputs.previous_action[:, :, 1:], episodes.action[:, :, :-1])
    np.testing.assert_array_equal(inputs.previous_reward[:, :, 1:], episodes.reward[:, :, :-1])
