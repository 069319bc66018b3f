"""The reference against itself and against calculus: a wrong ruler measures nothing."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.stats
from learning_problems.prepared import UNEQUAL, make_problem
from reference.advantage import discounted_returns, generalized_advantages
from reference.maesn import Agent, Settings, loss, mean_kl, pathwise_gradient, start
from reference.parameters import Array, flatten, unflatten
from reference.policy import action_log_std, action_mean, divergence, log_density
from reference.trust_region import conjugate_gradient, curvature, kl_gradient, loss_gradient

SETTINGS = [Settings(), Settings(gradient="reparameterized"), Settings(theta_step=0.1)]


def central_difference(function: Callable[[Array], Any], x: Array, width: float = 1e-5) -> Array:
    """Differentiate by real steps, one parameter at a time."""
    steps = width * np.eye(len(x))
    return np.array([(function(x + s) - function(x - s)) / (2 * width) for s in steps])


@pytest.mark.parametrize("settings", SETTINGS)
def test_gradients_agree_with_central_differences(settings: Settings) -> None:
    problem = make_problem(2, UNEQUAL, settings, inner_updates=2)
    flat, tasks = flatten(problem.parameters), problem.tasks[:2]
    shifted = unflatten(flat + 0.03, problem.parameters)
    for value, gradient in ((loss, loss_gradient), (mean_kl, kl_gradient)):
        expected = central_difference(
            lambda x, value=value: value(unflatten(x, shifted), tasks, settings), flat + 0.03
        )
        actual = gradient(shifted, tasks, settings)
        np.testing.assert_allclose(actual, expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("settings", SETTINGS)
def test_curvature_is_the_hessian_of_the_divergence(settings: Settings) -> None:
    problem = make_problem(2, UNEQUAL, settings)
    flat, tasks = flatten(problem.parameters), problem.tasks[:2]
    rng = np.random.default_rng(0)
    matrix = curvature(problem.parameters, tasks, settings)
    for vector in rng.normal(size=(2, len(flat))):
        ahead, behind = (
            kl_gradient(unflatten(flat + side * vector, problem.parameters), tasks, settings)
            for side in (1e-4, -1e-4)
        )
        expected = (ahead - behind) / 2e-4
        error = np.abs(matrix @ vector - expected).max()
        assert error < 1e-5 * np.abs(expected).max()


def test_the_agents_that_played_have_no_divergence() -> None:
    problem = make_problem(2, UNEQUAL)
    assert abs(mean_kl(problem.parameters, problem.tasks, problem.settings)) < 1e-15


@pytest.mark.parametrize("redrawn", [True, False])
def test_the_chain_rule_agrees_with_central_differences(redrawn: bool) -> None:
    problem = make_problem(0, UNEQUAL)
    played, agent = problem.tasks[0].pre[0], start(problem.parameters, 0)
    everything = agent.theta | {"mean": agent.mean, "log_std_of_z": agent.log_std}

    def objective(flat: Array) -> Any:
        values = unflatten(flat, everything)
        moved = Agent(values, values["mean"], values["log_std_of_z"])
        gains = []
        for episode, advantage in zip(played.episodes, played.step_advantages, strict=True):
            drawn = moved.draw(episode.noise) if redrawn else episode.latent
            mean = action_mean(values, episode.observation, drawn)
            gains.append(log_density(episode.action, mean, action_log_std(values)) * advantage)
        return np.mean(np.concatenate(gains))

    theta, mean, log_std = pathwise_gradient(agent, played, redrawn=redrawn)
    if not redrawn:
        # The recorded z does not move with the latent; a deterministic context would.
        mean, log_std = np.zeros_like(mean), np.zeros_like(log_std)
    names = [*agent.theta, "mean", "log_std_of_z"]
    actual = flatten(
        {name: (theta | {names[-2]: mean, names[-1]: log_std})[name] for name in names}
    )
    expected = central_difference(objective, flatten(everything))
    np.testing.assert_allclose(actual, expected, atol=1e-8)


def test_densities_agree_with_scipy_and_divergence_with_quadrature() -> None:
    mean, log_std = np.array([0.3, -1.0]), np.array([0.2, -0.7])
    value = np.array([1.0, -1.5])
    expected = scipy.stats.norm(mean, np.exp(log_std)).logpdf(value).sum()
    np.testing.assert_allclose(log_density(value, mean, log_std), expected, rtol=1e-13)
    other_mean, other_log_std = np.array([0.0, -0.5]), np.array([-0.1, 0.1])
    # Gauss-Hermite quadrature with 3 nodes is exact for polynomials of degree 5.
    nodes, weights = np.polynomial.hermite_e.hermegauss(3)
    total = 0.0
    for d in range(2):
        x = mean[d] + np.exp(log_std[d]) * nodes
        ratio = scipy.stats.norm(mean[d], np.exp(log_std[d])).logpdf(x)
        ratio -= scipy.stats.norm(other_mean[d], np.exp(other_log_std[d])).logpdf(x)
        total += weights @ ratio / weights.sum()
    actual = divergence(mean, log_std, other_mean, other_log_std)
    np.testing.assert_allclose(actual, total, rtol=1e-13)


def test_returns_and_advantages_by_hand() -> None:
    reward, value = np.array([1.0, 2.0, 4.0]), np.array([0.5, -1.0, 3.0])
    np.testing.assert_allclose(discounted_returns(reward, 0.5), [3.0, 4.0, 4.0])
    # delta = (1 - .5 - .5, 2 + 1.5 + 1, 4 - 3) with discount 1/2, then gae_lambda 1/2.
    actual = generalized_advantages(reward, value, 0.5, 0.5)
    np.testing.assert_allclose(actual, [0.0 + 4.75 / 4, 4.5 + 1 / 4, 1.0])


def test_conjugate_gradients_solve() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    matrix, target = root @ root.T + np.eye(6), rng.normal(size=6)
    actual = conjugate_gradient(matrix, target, steps=6)
    np.testing.assert_allclose(actual, np.linalg.solve(matrix, target), atol=1e-8)
