"""Fine-tuning: first the learner's own updates, then policy gradient on its agents' weights."""

from dataclasses import replace
from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from playing import keys

from maesn import BonusFastLearner, FineTuning, PolicyGradient, PolicyImprovement, maesn, rl2
from maesn.envs import point
from maesn.experience.episodes import concatenate
from maesn.learners import SCRATCH, TRPO, GradientStep, Problem
from maesn.learners.gradient.fast_learner import GradientFastLearner
from maesn.learners.gradient.outer import TrustRegionOuterStep
from maesn.learners.policy_steps import AbstractPolicyStep
from maesn.learners.wrappers.curiosity import CuriosityBonus
from maesn.numerics.normalization import ObservationStatistics
from maesn.policies import AnnealedGaussianMLP, GaussianMLP, Recurrent
from maesn.rules import NoAdaptation, Trained
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

TASKS = 2


@pytest.fixture(scope="module")
def collect() -> Collector:
    env = point.make_env(reward_kind="dense", horizon=8)
    return Collector(make_world(env, point.task_set("test", size=TASKS)), 5)


def fast(preset: object = maesn) -> GradientFastLearner:
    learner = preset(policy=GaussianMLP((6,)), meta_batch_size=2)
    return learner.fast_learner(learner.init(jax.random.key(0), Problem(2, 2, TASKS)))


@pytest.mark.parametrize("rule", [TRPO, GradientStep()])
def test_the_learner_comes_first_and_the_weights_after_it(
    rule: AbstractPolicyStep, collect: Collector
) -> None:
    inner = fast()
    learner = FineTuning(inner, PolicyImprovement(rule), after=10, least_batch=5)
    state, alone, agents = learner.init(keys(TASKS)), inner.init(keys(TASKS)), []
    for update in range(4):
        agents.append(learner.agents(state))
        episodes = collect(keys(TASKS, update), agents[-1], jnp.arange(TASKS))
        if update < 2:
            # Until then it is the learner itself.
            for one, other in zip(
                *map(jax.tree.leaves, (agents[-1], inner.agents(alone))), strict=True
            ):
                np.testing.assert_array_equal(one, other)
            alone = inner.update(alone, episodes)
        state = learner.update(state, episodes)
    # Two updates of 5 episodes each were the learner's.
    assert int(state.episodes) == 20
    settled = inner.agents(alone)
    assert not agents[2].shares_policy
    for after in (agents[2], learner.agents(state)):
        np.testing.assert_array_equal(after.context.mean, settled.context.mean)
        np.testing.assert_array_equal(after.context.log_std, settled.context.log_std)
    for start, began, now in zip(
        *(jax.tree.leaves(a.policy) for a in (settled, agents[2], learner.agents(state))),
        strict=True,
    ):
        np.testing.assert_array_equal(began, jnp.stack([start] * TASKS))
        assert (now != began).any()
        assert (now[0] != now[1]).any()


def test_a_tuned_step_is_that_of_the_rule_on_the_frozen_latent(collect: Collector) -> None:
    inner, improvement = fast(), PolicyImprovement()
    learner = FineTuning(inner, improvement, after=0, least_batch=5)
    state = learner.init(keys(TASKS))
    episodes = collect(keys(TASKS), learner.agents(state), jnp.arange(TASKS))
    # z was drawn for every episode.
    assert np.ptp(np.asarray(episodes.z), axis=1).min() > 0
    found = learner.agents(learner.update(state, episodes)).policy
    begun = improvement.begin(keys(TASKS), inner.agents(inner.init(keys(TASKS))))
    expected = improvement(begun, episodes).agents.policy
    for one, other in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        np.testing.assert_array_equal(one, other)


def test_episodes_of_small_updates_are_saved_for_one_step(collect: Collector) -> None:
    inner, improvement = fast(), PolicyImprovement(GradientStep())
    learner = FineTuning(inner, improvement, after=5, least_batch=15)
    states = [learner.init(keys(TASKS))]
    played = []
    for update in range(5):
        played.append(collect(keys(TASKS, update), learner.agents(states[-1]), jnp.arange(TASKS)))
        states.append(learner.update(states[-1], played[-1]))
    weights = [np.asarray(learner.agents(one).policy.log_std) for one in states[1:]]
    np.testing.assert_array_equal(weights[1:3], weights[:1] * 2)
    assert (weights[3] != weights[2]).all()
    np.testing.assert_array_equal(weights[4], weights[3])
    batch = reduce(concatenate, played[1:4])
    expected = improvement(states[1].tuning, batch).agents.policy
    np.testing.assert_array_equal(weights[3], expected.log_std)


def test_recurrent_policies_are_refused_at_construction() -> None:
    learner = rl2()
    recurrent = learner.fast_learner(learner.init(jax.random.key(0), Problem(2, 2, 40)))
    settings = {
        "policy": Recurrent(hidden_size=4),
        "outer": TrustRegionOuterStep(curvature_stride=1),
        "meta_batch_size": 2,
    }
    remembers = maesn(**settings)
    gradient = remembers.fast_learner(remembers.init(jax.random.key(0), Problem(2, 2, TASKS)))
    trained = Trained(rl2(), rl2().init(jax.random.key(0), Problem(2, 2, 40)))
    still = NoAdaptation().fast_learner(trained, point.make_env())
    with_bonus = BonusFastLearner(gradient, CuriosityBonus(), 2, 2)
    for learner in (recurrent, gradient, with_bonus, still):
        with pytest.raises(ValueError, match="`learner` must not be recurrent"):
            FineTuning(learner, PolicyImprovement())
    with pytest.raises(ValueError, match="`policy` must not be annealed"):
        PolicyGradient(2, 2, AnnealedGaussianMLP())
    with pytest.raises(ValueError, match="`policy` must not be recurrent, got Recurrent:"):
        PolicyGradient(2, 2, Recurrent())
    with pytest.raises(ValueError, match="`learner` must learn from the sum"):
        BonusFastLearner(recurrent, CuriosityBonus(), 2, 2)
    with pytest.raises(ValueError, match="`observation_size` must be at least 1, got 0: curiosity"):
        SCRATCH["vime"](0, 2).init(keys(1))


def test_the_normalisation_of_observations_stays(collect: Collector) -> None:
    statistics = ObservationStatistics(jnp.ones(()), jnp.array([1.0, -1.0]), jnp.array([4.0, 0.5]))
    inner, improvement = fast(), PolicyImprovement(GradientStep())
    settled = replace(inner.agents(inner.init(keys(TASKS))), statistics=statistics)
    state = improvement.begin(keys(TASKS), settled)
    played = collect(keys(TASKS), state.agents, jnp.arange(TASKS))
    moved = improvement(state, played).agents
    for one, other in zip(*map(jax.tree.leaves, (moved.statistics, statistics)), strict=True):
        np.testing.assert_array_equal(one, other)
    # The step is taken through the same normalisation: without it, it would be another one.
    plain = replace(state, agents=replace(state.agents, statistics=None))
    other = improvement(plain, played).agents.policy.mlp.layers[0].weight
    assert (moved.policy.mlp.layers[0].weight != other).any()
