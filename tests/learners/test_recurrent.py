"""RL2 as a learner: trials, their memory, and what it is refused."""

import logging
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.memory import assert_a_probe_of_memory_is_solved
from learning_problems.watching import EPISODES, TASKS, Watching

from maesn import (
    GradientMetaLearner,
    ProximalStep,
    RecurrentMetaLearner,
    RecurrentValue,
    TrustRegionStep,
    maesn,
    rl2,
)
from maesn.evaluation.adapting import adapt
from maesn.learners import Problem
from maesn.learners.gradient.outer import TrustRegionOuterStep
from maesn.learners.recurrent.meta_learner import RecurrentMetaState
from maesn.learners.trials import Trials, join_episodes
from maesn.numerics import MinibatchDescent
from maesn.numerics.trust_region import TrustRegion
from maesn.policies import HyperRecurrent, Recurrent

TRIAL = 3
DESCENT = MinibatchDescent(epochs=2, minibatches=2)


def small(**settings: Any) -> RecurrentMetaLearner:
    return rl2(
        **{
            "policy": Recurrent(hidden_size=4, readout_sizes=(3,)),
            "policy_step": ProximalStep(descent=DESCENT),
            "value": RecurrentValue((), 4, (3,), DESCENT),
            "meta_batch_size": 2,
            "trial_episodes": TRIAL,
            "discount": 0.9,
            "gae_lambda": 0.8,
            **settings,
        }
    )


def assert_goes_on(collect: Watching) -> None:
    """A trial begins anew, and each of its episodes goes on from the one before."""
    assert collect.stages == [0, 1, 2]
    assert collect.agents[0].trial_state is None
    for agents, before in zip(collect.agents[1:], collect.played[:-1], strict=True):
        assert agents.trial_state is before.trial_end


def start(learner: RecurrentMetaLearner) -> RecurrentMetaState:
    return learner.init(jax.random.key(0), Problem(1, 1, TASKS))


@pytest.mark.parametrize(
    "slots",
    [
        {},
        {"policy": HyperRecurrent(hidden_size=4, readout_sizes=(3,), symlog=True)},
        pytest.param(
            {"policy_step": TrustRegionStep(TrustRegion(cg_steps=3), curvature_stride=2)},
            marks=pytest.mark.long,
        ),
    ],
    ids=["gated", "hypernetwork", "trust region"],
)
def test_a_meta_iteration_plays_trials_and_improves(
    slots: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    learner, collect = small(**slots), Watching()
    state = start(learner)
    after, info = learner.step(jax.random.key(1), state, collect)
    assert int(learner.iteration(after)) == 1
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((after, info)))
    moved = jax.tree.map(lambda x, y: bool((x != y).any()), state.policy, after.policy)
    assert all(jax.tree.leaves(moved))
    assert_goes_on(collect)
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        jax.jit(lambda x: x + 1)(0.5)
        assert "Compiling" in caplog.text
        caplog.clear()
        learner.step(jax.random.key(2), after, collect)
    assert "Compiling" not in caplog.text
    assert [agents.trial_state is None for agents in collect.agents] == [True, False, False] * 2
    returns = [float(episodes.undiscounted_return.mean()) for episodes in collect.played[:TRIAL]]
    assert float(info.return_before) == pytest.approx(returns[0])
    assert float(info.return_after) == pytest.approx(returns[-1])


def test_advantages_span_the_trial() -> None:
    """Against loops over the steps that were played, episode after episode."""
    learner, collect = small(), Watching()
    learner.step(jax.random.key(1), start(learner), collect)
    trials = join_episodes(collect.played)
    expected = np.random.default_rng(0).normal(size=trials.valid.shape).astype(np.float32)
    actual = np.asarray(learner.advantages(trials, jnp.asarray(expected)))
    for row in range(len(actual)):
        steps, following, advantage = np.flatnonzero(trials.valid[row]), 0.0, 0.0
        assert len(steps) < actual.shape[1] or row >= EPISODES
        for step in steps[::-1]:
            delta = float(trials.reward[row, step]) + 0.9 * following - expected[row, step]
            advantage = delta + 0.9 * 0.8 * advantage
            following = expected[row, step]
            assert actual[row, step] == pytest.approx(advantage, rel=1e-4, abs=1e-5)
    assert not actual[~np.asarray(trials.valid)].any()


@cache
def trials_of_unequal_length() -> Trials:
    collect, learner = Watching(20, 30, 20, 30), small()
    learner.step(jax.random.key(1), start(learner), collect)
    return join_episodes(collect.played)


def test_a_fit_that_does_not_end_in_numbers_leaves_the_value_function_as_it_was() -> None:
    value = RecurrentValue((), 4, (), MinibatchDescent(minibatches=1))
    trials = trials_of_unequal_length()
    before = value.init(jax.random.key(0), 1, 1)
    returns = jnp.ones(trials.valid.shape)
    fit = eqx.filter_jit(RecurrentValue.fit)
    unknown = returns.at[0, 0].set(jnp.nan)
    broken, accepted = fit(value, jax.random.key(1), before, trials, unknown)
    assert not accepted
    jax.tree.map(np.testing.assert_array_equal, broken, before)
    after, accepted = fit(value, jax.random.key(1), broken, trials, returns)
    assert accepted
    moved = jax.tree.map(lambda new, old: bool((new != old).any()), after.network, before.network)
    assert any(jax.tree.leaves(moved))


@pytest.mark.long
@pytest.mark.parametrize("method", ["rl2", "rl2_trpo"])
def test_a_probe_that_needs_memory_across_episodes_is_solved(method: str) -> None:
    assert_a_probe_of_memory_is_solved(method)


def test_in_a_new_task_the_state_of_the_trials_is_all_that_changes() -> None:
    learner, collect = small(), Watching()
    fast = learner.fast_learner(start(learner))
    adapt(fast, collect, episodes=2 * EPISODES)
    assert_goes_on(collect)


def test_too_few_tasks_are_refused() -> None:
    with pytest.raises(ValueError, match="`meta_batch_size` is 20, but the training set holds"):
        rl2().init(jax.random.key(0), Problem(1, 1, TASKS))


def test_thinned_curvature_is_refused_for_recurrent_policies() -> None:
    slots = maesn()
    with pytest.raises(ValueError, match="curvature_stride` is 20, but a recurrent policy"):
        GradientMetaLearner(slots.context, slots.adaptation, Recurrent())
    strides = {"outer": TrustRegionOuterStep(curvature_stride=1, hessian_stride=4)}
    with pytest.raises(ValueError, match="hessian_stride` is 4, but a recurrent policy"):
        GradientMetaLearner(slots.context, slots.adaptation, Recurrent(), **strides)
