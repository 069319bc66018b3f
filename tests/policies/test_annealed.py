"""A bound on the noise of actions that falls during meta-training."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.analytic import ACTION, OBSERVATION, AnalyticCollect

from maesn import RecurrentMetaLearner, maesn
from maesn.learners import Problem
from maesn.learners.gradient.meta_learner import GradientState
from maesn.learners.gradient.outer import TrustRegionOuterStep
from maesn.policies import AnnealedGaussianMLP, CategoricalMLP, GaussianMLP

TASKS = 4
SETTINGS = AnnealedGaussianMLP(
    GaussianMLP(()), final_std=0.25, first_iteration=10, last_iteration=20
)


def std_after(iteration: int, std: float) -> float:
    policy = SETTINGS.init(jax.random.key(0), OBSERVATION, ACTION, 0)
    noisy = type(policy)(policy.mlp, jnp.full(ACTION, jnp.log(std)))
    found = SETTINGS.after_iteration(noisy, jnp.asarray(iteration))
    np.testing.assert_array_equal(found.mlp.layers[0].weight, policy.mlp.layers[0].weight)
    return float(jnp.exp(found.log_std[0]))


@pytest.mark.parametrize(
    ("iteration", "bound"), [(10, 1.0), (15, 0.5), (20, 0.25), (21, 0.25), (1000, 0.25)]
)
def test_the_bound_falls_geometrically(iteration: int, bound: float) -> None:
    assert std_after(iteration, std=3.0) == pytest.approx(bound, rel=1e-6)
    assert std_after(iteration, std=0.1) == pytest.approx(0.1, rel=1e-6)


def test_there_is_none_before() -> None:
    assert std_after(9, std=3.0) == pytest.approx(3.0, rel=1e-6)


def one_step(policy: AnnealedGaussianMLP | GaussianMLP, iteration: int) -> GradientState:
    learner = maesn(
        policy=policy, meta_batch_size=TASKS, outer=TrustRegionOuterStep(curvature_stride=2)
    )
    state = learner.init(jax.random.key(1), Problem(OBSERVATION, ACTION, TASKS))
    state = GradientState(state.parameters, jnp.asarray(iteration))
    return learner.step(jax.random.key(2), state, AnalyticCollect(TASKS))[0]


def test_a_meta_iteration_ends_within_the_bound_and_is_the_usual_one_else() -> None:
    limited, usual = (one_step(SETTINGS, iteration) for iteration in (14, 5))
    np.testing.assert_allclose(np.exp(limited.parameters.policy.log_std), 0.5, rtol=1e-6)
    assert (np.exp(usual.parameters.policy.log_std) > 0.9).all()
    for found, wanted in zip(
        jax.tree.leaves((limited.parameters.policy.mlp, limited.parameters.context_table)),
        jax.tree.leaves((usual.parameters.policy.mlp, usual.parameters.context_table)),
        strict=True,
    ):
        np.testing.assert_array_equal(found, wanted)


def test_a_learner_of_trials_keeps_within_the_bound() -> None:
    learner = RecurrentMetaLearner(policy=SETTINGS, trial_episodes=1, meta_batch_size=TASKS)
    state = learner.init(jax.random.key(1), Problem(OBSERVATION, ACTION, TASKS))
    state = replace(state, iteration=jnp.asarray(14))
    after = learner.step(jax.random.key(2), state, AnalyticCollect(TASKS))[0]
    assert (np.exp(after.policy.log_std) < 0.501).all()


def test_choices_have_no_noise_to_bound() -> None:
    assert SETTINGS.for_actions("discrete") == CategoricalMLP(())
    assert SETTINGS.for_actions("continuous") == SETTINGS
