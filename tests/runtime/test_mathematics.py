"""Baseline, latent and policy of the runtime against closed forms and finite differences."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
import scipy.stats
from runtime.robot import fast_learner

from maesn.envs import Point
from maesn.evaluation.exporting import exported_policy
from maesn.policies import PolicyInput
from maesn.runtime import Latent, LearningRule, baseline


def rule(full_steps: int = 2, factor: float = 0.5) -> LearningRule:
    ones = np.ones(2)
    return LearningRule(ones, ones, full_steps, factor, discount=0.99, ridge=1e-5)


def test_ridge_regression_gives_nothing_to_a_column_of_zeros() -> None:
    rows = np.zeros((5, 2))
    rows[:, 0] = 1.0
    found = baseline.ridge_regression(rows, np.full(5, 2.0), 1e-5)
    np.testing.assert_allclose(found, [2.0, 0.0], atol=1e-5)


def test_equal_values_are_standardised_to_zero() -> None:
    assert not baseline.standardize(np.full(7, 0.1)).any()


def test_a_step_follows_the_gradient_of_the_surrogate() -> None:
    generator = np.random.default_rng(3)
    latent = Latent(np.asarray([0.3, -1.0]), np.asarray([0.2, -0.5]))
    drawn, advantage = generator.standard_normal((9, 2)), generator.standard_normal(9)

    def surrogate(parameters: np.ndarray) -> float:
        log_prob = scipy.stats.norm.logpdf(drawn, parameters[:2], np.exp(parameters[2:])).sum(-1)
        return float(np.mean(log_prob * advantage))

    at = np.concatenate([latent.mean, latent.log_std])
    nudges = 1e-5 * np.eye(4)
    slope = [(surrogate(at + nudge) - surrogate(at - nudge)) / 2e-5 for nudge in nudges]
    moved = rule().step(latent, drawn, advantage, update=0)
    np.testing.assert_allclose(np.concatenate([moved.mean, moved.log_std]) - at, slope, rtol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_the_policy_s_mean_is_the_library_s(seed: int) -> None:
    learner = fast_learner()
    policy = exported_policy(learner, Point(), {}).policy
    observation, z = np.random.default_rng(seed).standard_normal((2, 2))
    wanted, _ = learner.policy(
        PolicyInput(
            jnp.asarray(observation, jnp.float32), jnp.zeros(2), jnp.zeros(()), jnp.asarray(False)
        ),
        jnp.asarray(z, jnp.float32),
        None,
    )
    np.testing.assert_allclose(policy.given(z).mean(observation), wanted.mean, atol=1e-6)
    np.testing.assert_allclose(policy.std, np.exp(wanted.log_std), rtol=1e-6)


def test_a_policy_without_hidden_layers() -> None:
    learner = fast_learner()
    layers = exported_policy(learner, Point(), {}).policy
    linear = type(layers)((np.eye(4, 2, dtype=np.float32),), (np.ones(2, np.float32),), layers.std)
    np.testing.assert_allclose(linear.given(np.full(2, 9.0)).mean(np.asarray([1.0, 2.0])), [2, 3])
