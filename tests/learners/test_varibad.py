"""VariBAD: its policy and its belief in trials, its meta-iterations, and what it is refused."""

import logging
from dataclasses import replace
from functools import cache, partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.probes import HiddenSide
from learning_problems.watching import EPISODES, TASKS, Watching

from maesn import (
    BeliefDecoderSettings,
    BeliefEncoderSettings,
    BeliefInference,
    BeliefValue,
    HyperBonus,
    ProximalStep,
    VaribadMetaLearner,
    varibad,
)
from maesn.envs import TaskSet
from maesn.evaluation.adapting import adapt
from maesn.experience.episodes import Episodes
from maesn.learners import Problem
from maesn.learners.trials import join_episodes
from maesn.learners.varibad.meta_learner import MOST_BUFFER_BYTES, VaribadState
from maesn.learners.varibad.policy import BeliefPolicy
from maesn.learners.varibad.steps import steps_of
from maesn.numerics import MinibatchDescent
from maesn.numerics.normalization import ObservationStatistics
from maesn.policies import GaussianMLP, HyperRecurrent
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

TRIAL = 3
DESCENT = MinibatchDescent(epochs=2, minibatches=2)
PROBLEM = Problem(1, 1, TASKS, horizon=6, episodes_per_task=EPISODES)
SMALL = {
    "encoder": BeliefEncoderSettings(2, (), 5),
    "decoder": BeliefDecoderSettings((4,)),
    "inference": BeliefInference(
        prefixes=5, decoded_steps=4, buffer_trials=20, batch_size=3, updates=2
    ),
    "policy": GaussianMLP((4,)),
    "policy_step": ProximalStep(descent=DESCENT),
    "value": BeliefValue((4,), DESCENT),
    "meta_batch_size": 2,
    "trial_episodes": TRIAL,
}
ALL = HyperBonus(0.1, 0.2, hidden_sizes=(4,), output_size=3, batch_size=5)


def small(**settings: Any) -> VaribadMetaLearner:
    return varibad(**SMALL | settings)


def begun(learner: VaribadMetaLearner) -> VaribadState:
    """An untrained state whose statistics are not those of the beginning."""
    state = learner.init(jax.random.key(0), PROBLEM)
    size = state.networks.policy.statistics.mean.size
    places = jnp.arange(float(size))
    statistics = ObservationStatistics(jnp.asarray(50.0), 0.1 * places, 0.5 + 0.2 * places)
    return eqx.tree_at(lambda one: one.networks.policy.statistics, state, statistics)


@cache
def played(policy: Any) -> tuple[BeliefPolicy, list[Episodes]]:
    """A trial's episodes, played by a policy with one of two networks."""
    learner, collect = small(policy=policy), Watching()
    state = begun(learner)
    learner.step(jax.random.key(1), state, collect)
    return state.networks.policy, collect.played


NETWORKS = [GaussianMLP((4,)), HyperRecurrent(hidden_size=3, readout_sizes=(3,))]


@pytest.mark.parametrize(
    "network", [NETWORKS[0], pytest.param(NETWORKS[1], marks=pytest.mark.long)]
)
def test_the_policy_learns_from_the_beliefs_that_it_played_with(network: Any) -> None:
    """Beliefs of whole trials, last observations included, give the recorded distributions."""
    policy, episodes = played(network)
    steps, trials = steps_of(episodes), join_episodes(episodes)
    beliefs = jax.vmap(policy.encoder.posteriors)(steps)
    seen = policy.hyper_state(trials.inputs.observation, jax.tree.map(lambda x: x[:, :-1], beliefs))
    fed = replace(trials, inputs=trials.inputs._replace(observation=seen))
    again = fed.distributions(policy.policy)
    valid = np.asarray(trials.valid)
    assert 0 < valid.sum() < valid.size
    for name in ("mean", "log_std"):
        np.testing.assert_allclose(
            np.asarray(getattr(again, name))[valid],
            np.asarray(getattr(trials.behaviour, name))[valid],
            rtol=1e-4,
            atol=1e-5,
        )
    assert np.abs(np.diff(beliefs.mean, axis=1)).max() > 0.05
    # Every step counts, the last one of an episode as well: its belief is the next one's first.
    last = jax.tree.map(lambda x: x[:, -1], beliefs)
    hidden = episodes[-1].trial_end.recurrent_state.hidden.reshape(-1, 5)  # type: ignore[union-attr]
    end = jax.vmap(policy.encoder.posterior)(hidden)
    np.testing.assert_allclose(last.mean, end.mean, rtol=1e-4, atol=1e-5)


def test_an_observation_that_is_not_finite_changes_no_belief() -> None:
    policy, episodes = played(NETWORKS[0])
    state = policy.initial_recurrent_state()
    seen = jax.tree.map(lambda x: x[0, 0, 1], episodes[0].policy_inputs())
    broken = seen._replace(observation=jnp.full(1, jnp.nan))
    np.testing.assert_array_equal(policy.after_episode(broken, state).hidden, state.hidden)
    assert (policy.after_episode(seen, state).hidden != state.hidden).any()


# Meta-iterations.


@pytest.mark.parametrize("bonus", [pytest.param(HyperBonus(), marks=pytest.mark.long), ALL])
def test_a_meta_iteration_plays_trials_believes_and_improves(
    bonus: HyperBonus, caplog: pytest.LogCaptureFixture
) -> None:
    learner, collect = (
        small(bonus=bonus, decoder=BeliefDecoderSettings((4,), transitions=True)),
        Watching(),
    )
    state = learner.init(jax.random.key(0), PROBLEM)
    after, info = learner.step(jax.random.key(1), state, collect)
    assert int(learner.iteration(after)) == 1
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((after, info)))
    assert bool(info.value_accepted)
    assert bool(info.inference_accepted)
    assert bool(info.bonus_accepted)
    moved = jax.tree.map(lambda x, y: bool((x != y).any()), state.networks, after.networks)
    assert all(jax.tree.leaves(moved))
    assert (float(info.bonus) > 0) == (bonus.novelty_weight + bonus.error_weight > 0)
    returns = [float(episodes.undiscounted_return.mean()) for episodes in collect.played]
    assert (float(info.return_before), float(info.return_after)) == pytest.approx(
        (returns[0], returns[-1])
    )
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        caplog.clear()
        learner.step(jax.random.key(2), after, collect)
    assert "Compiling" not in caplog.text


def test_a_surprise_beyond_all_bounds_spoils_no_later_bonus() -> None:
    learner = small(bonus=ALL, decoder=BeliefDecoderSettings((4,)))
    state = learner.init(jax.random.key(0), PROBLEM)
    wild = jax.tree.map(lambda x: 1e30 * jnp.ones_like(x), state.networks.decoder)
    state = eqx.tree_at(lambda one: one.networks.decoder, state, wild)
    after, info = learner.step(jax.random.key(1), state, Watching())
    assert float(info.bonus) == 0.0
    assert not bool(info.bonus_accepted)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(after.bonus))
    assert bool(info.value_accepted)


def test_no_gradient_runs_from_the_policy_into_the_belief() -> None:
    """Another step of the policy leads to the same encoder and decoder, bit for bit."""
    rates = (DESCENT.learning_rate, 1e-1)  # the first one is compiled already
    states = []
    for rate in rates:
        step = ProximalStep(descent=replace(DESCENT, learning_rate=rate))
        learner = small(policy_step=step)
        state = learner.init(jax.random.key(0), PROBLEM)
        states.append(learner.step(jax.random.key(1), state, Watching())[0].networks)
    same = [
        jax.tree.map(lambda x, y: bool((x == y).all()), *pair)
        for pair in (
            [(one.policy.encoder, one.decoder) for one in states],
            [one.policy.policy for one in states],
        )
    ]
    assert all(jax.tree.leaves(same[0]))
    assert not any(jax.tree.leaves(same[1]))


def test_statistics_are_those_of_all_that_the_policy_saw() -> None:
    learner, collect = small(), Watching()
    state = learner.init(jax.random.key(0), PROBLEM)
    after, _ = learner.step(jax.random.key(1), state, collect)
    trials = join_episodes(collect.played)
    encoder = state.networks.policy.encoder
    beliefs = jax.vmap(encoder.posteriors)(steps_of(collect.played))
    seen = np.concatenate(
        [trials.inputs.observation, beliefs.mean[:, :-1], beliefs.log_std[:, :-1]], axis=-1
    )[np.asarray(trials.valid)]
    found = after.networks.policy.statistics
    np.testing.assert_allclose(found.mean, seen.mean(0), rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(found.variance, seen.var(0), rtol=1e-3, atol=1e-6)


@pytest.mark.long
def test_a_probe_of_memory_is_solved() -> None:
    """The reward of a hidden side, at the end of the first episode, says where to go.

    Without a belief across episodes the second returns 1/2 at best, as the first does.
    """
    env = HiddenSide(horizon=1, reward_kind="sparse")
    collect = Collector(make_world(env, TaskSet(np.float32([-1.0, 1.0] * 20))), 10)
    descent = MinibatchDescent(1e-2, epochs=4, minibatches=2)
    learner = varibad(
        encoder=BeliefEncoderSettings(2, (8,), 8),
        decoder=BeliefDecoderSettings((8,), "bernoulli"),
        inference=BeliefInference(kl_weight=0.01, batch_size=50, updates=10, learning_rate=1e-2),
        policy=GaussianMLP((8,)),
        policy_step=ProximalStep(descent=descent),
        value=BeliefValue((8,), descent),
        meta_batch_size=40,
    )
    state = learner.init(jax.random.key(0), Problem(env.observation_size, env.action_size, 40))
    for iteration in range(80):
        state, _ = learner.step(jax.random.key(iteration), state, collect)
    fast = replace(learner.fast_learner(state), is_noisy=True)
    first, second = adapt(fast, collect, episodes=10).curves.mean_return.mean(0)
    # 400 trials: the standard error of the first, a coin, is 0.025.
    assert abs(first - 0.5) < 0.1
    assert second > 0.9


# New tasks and runs.


def test_in_a_new_task_it_acts_without_noise_and_its_belief_goes_on() -> None:
    learner, collect = small(), Watching()
    fast = learner.fast_learner(begun(learner))
    outcome = adapt(fast, collect, episodes=2 * EPISODES)
    assert outcome.trial_episodes == TRIAL
    for episodes in collect.played:
        np.testing.assert_array_equal(episodes.action, episodes.behaviour.mode())
    for later, before in zip(collect.played[1:], collect.played, strict=False):
        for x, y in zip(*map(jax.tree.leaves, (later.trial_start, before.trial_end)), strict=True):
            np.testing.assert_array_equal(x, y)


# What is refused.


def test_the_memory_of_the_buffer_is_bounded() -> None:
    problem = PROBLEM._replace(observation_size=100, horizon=200)
    learner = small(inference=BeliefInference(buffer_trials=10**6))
    state = jax.eval_shape(partial(learner.init, problem=problem), jax.random.key(0))
    size = sum(4 * leaf.size for leaf in jax.tree.leaves(state.buffer))
    assert 0.9 * MOST_BUFFER_BYTES < size <= MOST_BUFFER_BYTES + 4


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"meta_batch_size": 9}, "`meta_batch_size` is 9, but the training set holds only 4"),
        ({"decoder": BeliefDecoderSettings(cells=(5, 5))}, "needs observations of 2 components"),
    ],
)
def test_tasks_that_it_cannot_learn_from_are_refused(settings: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        small(**settings).init(jax.random.key(0), PROBLEM)


def test_batches_that_it_cannot_learn_from_are_refused() -> None:
    with pytest.raises(ValueError, match="minibatches` is 2, but a meta-iteration has only 1"):
        small(meta_batch_size=1).check_batch(1)
