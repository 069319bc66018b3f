"""Squashed Gaussians against numeric integrals and the Gaussian before squashing."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

from maesn.numerics import DiagonalGaussian, SquashedGaussian

COORDINATES = [(0.0, 0.0), (0.7, -1.0), (-1.5, 0.5), (3.0, -2.0)]
each = pytest.mark.parametrize(("mean", "log_std"), COORDINATES)


def squashed(mean: float, log_std: float) -> SquashedGaussian:
    return SquashedGaussian(jnp.asarray([mean]), jnp.asarray([log_std]))


def integral(one: SquashedGaussian, function: Callable[[np.ndarray], np.ndarray]) -> float:
    """∫ p(x) f(x) dx in double precision, with x = tanh(u) as the variable of integration."""
    mean, std = float(one.mean[0]), float(np.exp(one.log_std[0]))

    u = np.linspace(max(mean - 6 * std, -6.0), min(mean + 6 * std, 6.0), 401)
    # The density comes from the code under test, dx = (1 - tanh²(u)) du from the integral.
    x = np.tanh(u)
    log_prob = one.log_prob(jnp.asarray(x[:, None], jnp.float32))
    density = np.exp(np.float64(log_prob))
    return float(scipy.integrate.simpson(density * (1 - x**2) * function(x), x=u))


@each
def test_the_density_integrates_to_one_and_gives_the_moments(mean: float, log_std: float) -> None:
    one = squashed(mean, log_std)
    # Single precision ends near u = 6, beyond which one of these has .3 % of its mass.
    assert integral(one, np.ones_like) == pytest.approx(1.0, abs=5e-3)
    first = integral(one, lambda x: x)
    variance = integral(one, lambda x: (x - first) ** 2)
    assert float(one.std()[0]) == pytest.approx(np.sqrt(variance), rel=2e-2)


@each
def test_entropy_is_the_mean_of_minus_the_log_density(mean: float, log_std: float) -> None:
    one = squashed(mean, log_std)
    noise = jax.random.normal(jax.random.key(0), (100_000, 1))
    drawn, log_prob = one.sample_and_log_prob(noise)
    assert float(one.entropy()) == pytest.approx(-float(log_prob.mean()), abs=2e-2)
    assert float(one.std()[0]) == pytest.approx(float(drawn.std()), rel=2e-2)


def test_both_ways_to_a_log_density_agree_where_the_event_can_be_inverted() -> None:
    one = SquashedGaussian(jnp.asarray([0.3, -0.8]), jnp.asarray([-0.5, 0.2]))
    noise = one.noise(jax.random.key(1), (50, 2))
    drawn, log_prob = one.sample_and_log_prob(noise)
    np.testing.assert_array_equal(drawn, one.sample_from_noise(noise))
    near = np.abs(drawn).max(-1) < 0.99
    np.testing.assert_allclose(log_prob[near], one.log_prob(drawn)[near], rtol=1e-3, atol=1e-3)


def test_all_is_finite_at_the_limits() -> None:
    far = SquashedGaussian(jnp.asarray([40.0]), jnp.asarray([0.0]))
    gradient = jax.grad(lambda mean: SquashedGaussian(mean, far.log_std).sample_and_log_prob(
        jnp.ones(1))[1])(far.mean)  # fmt: skip
    results = far.log_prob(jnp.ones(1)), far.entropy(), far.std(), far.mode(), gradient
    assert all(np.isfinite(result).all() for result in results)


def test_divergence_and_information_are_those_before_squashing() -> None:
    one = SquashedGaussian(jnp.asarray([0.3, -0.8]), jnp.asarray([-0.5, 0.2]))
    two = SquashedGaussian(jnp.asarray([0.1, 0.4]), jnp.asarray([0.3, -0.1]))
    noise = jax.random.normal(jax.random.key(2), (200_000, 2))
    drawn, log_prob = one.sample_and_log_prob(noise)
    u = one.unsquashed.sample_from_noise(noise)
    other = two.unsquashed.log_prob(u) - (one.unsquashed.log_prob(u) - log_prob)
    assert float(one.kl(two)) == pytest.approx(float((log_prob - other).mean()), rel=2e-2)
    product = one.fisher_product(two)
    expected = DiagonalGaussian(one.mean, one.log_std).fisher_product(
        DiagonalGaussian(two.mean, two.log_std)
    )
    np.testing.assert_array_equal(product.mean, expected.mean)
    np.testing.assert_array_equal(product.log_std, expected.log_std)
    np.testing.assert_allclose(one.mode(), jnp.tanh(one.mean))
    assert np.abs(drawn).max() <= 1
