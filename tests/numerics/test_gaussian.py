"""Diagonal Gaussians against SciPy, Gauss-Hermite quadrature and automatic differentiation."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from jax.flatten_util import ravel_pytree

from maesn.numerics import DiagonalGaussian


def _gaussian(seed: int, shape: tuple[int, ...] = (4, 3)) -> DiagonalGaussian:
    generator = np.random.default_rng(seed)
    return DiagonalGaussian(
        mean=jnp.asarray(generator.normal(size=shape), jnp.float32),
        log_std=jnp.asarray(0.5 * generator.normal(size=shape), jnp.float32),
    )


def _value(seed: int, shape: tuple[int, ...] = (4, 3)) -> jax.Array:
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), jnp.float32)


def _moments(gaussian: DiagonalGaussian) -> tuple[np.ndarray, np.ndarray]:
    return np.float64(gaussian.mean), np.exp(np.float64(gaussian.log_std))


def _quadrature_kl(first: DiagonalGaussian, second: DiagonalGaussian) -> np.ndarray:
    """KL as an integral: log p - log q is quadratic, so that five Hermite nodes are exact."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(5)
    (mean, std), (other_mean, other_std) = _moments(first), _moments(second)
    total = np.zeros(mean.shape[:-1])
    for node, weight in zip(nodes, weights / weights.sum(), strict=True):
        x = mean + std * node
        log_ratio = scipy.stats.norm.logpdf(x, mean, std)
        log_ratio = log_ratio - scipy.stats.norm.logpdf(x, other_mean, other_std)
        total += weight * log_ratio.sum(axis=-1)
    return total


def test_log_prob_agrees_with_scipy() -> None:
    gaussian, value = _gaussian(0), _value(1)
    expected = scipy.stats.norm.logpdf(np.float64(value), *_moments(gaussian)).sum(axis=-1)
    np.testing.assert_allclose(gaussian.log_prob(value), expected, rtol=1e-5)


def test_entropy_agrees_with_scipy() -> None:
    gaussian = _gaussian(0)
    expected = scipy.stats.norm.entropy(*_moments(gaussian)).sum(axis=-1)
    np.testing.assert_allclose(gaussian.entropy(), expected, rtol=1e-5)


def test_kl_agrees_with_quadrature_and_is_not_symmetric() -> None:
    first, second = _gaussian(0), _gaussian(1)
    np.testing.assert_allclose(first.kl(second), _quadrature_kl(first, second), rtol=1e-5)
    assert np.all(np.abs(first.kl(second) - second.kl(first)) > 1e-2)


def test_kl_of_equal_distributions_is_exactly_zero() -> None:
    gaussian = _gaussian(0)
    np.testing.assert_array_equal(gaussian.kl(gaussian), np.zeros(4))


def test_kl_of_nearly_equal_distributions_survives_single_precision() -> None:
    # KL = ½ (e^{2δ} - 1 - 2δ) = δ² + O(δ³): 1e-8, a twelfth of the rounding error of 1.
    nearly = DiagonalGaussian(
        mean=jnp.zeros(1, jnp.float32), log_std=jnp.full(1, 1e-4, jnp.float32)
    )
    standard = DiagonalGaussian(jnp.zeros(1, jnp.float32), jnp.zeros(1, jnp.float32))
    np.testing.assert_allclose(nearly.kl(standard), 1e-8, rtol=5e-3)


def test_fisher_product_is_the_hessian_of_the_kl_at_equality() -> None:
    gaussian, tangent = _gaussian(0, (3,)), _gaussian(1, (3,))
    flat, unravel = ravel_pytree(gaussian)
    hessian = jax.jit(jax.hessian(lambda other: gaussian.kl(unravel(other))))(flat)
    expected = hessian @ ravel_pytree(tangent)[0]
    actual = ravel_pytree(gaussian.fisher_product(tangent))[0]
    np.testing.assert_allclose(actual, expected, rtol=1e-5)
    assert not np.allclose(actual, ravel_pytree(tangent)[0])


def test_samples_have_the_mean_and_the_standard_deviation_within_five_sigma() -> None:
    gaussian, count = _gaussian(0, (3,)), 20_000
    noise = gaussian.noise(jax.random.key(0), (count, 3))
    samples = np.float64(gaussian.sample_from_noise(noise))
    mean, std = _moments(gaussian)
    assert np.all(np.abs(samples.mean(axis=0) - mean) < 5 * std / np.sqrt(count))
    assert np.all(np.abs(samples.std(axis=0) - std) < 5 * std / np.sqrt(2 * count))


def test_sample_is_differentiable_along_the_path() -> None:
    gaussian, noise = _gaussian(0, (3,)), _value(1, (3,))
    gradient = jax.grad(lambda g: jnp.sum(g.sample_from_noise(noise)))(gaussian)
    np.testing.assert_array_equal(gradient.mean, np.ones(3))
    np.testing.assert_allclose(
        gradient.log_std, _moments(gaussian)[1] * np.float64(noise), rtol=1e-5
    )


def test_leading_axes_broadcast_and_equal_vmap() -> None:
    single, values = _gaussian(0, (3,)), _value(1, (5, 4, 3))
    expected = jax.jit(jax.vmap(jax.vmap(single.log_prob)))(values)
    np.testing.assert_allclose(eqx.filter_jit(single.log_prob)(values), expected, rtol=1e-6)

    several, prior = _gaussian(2, (5, 3)), _gaussian(4, (3,))
    expected = jax.jit(jax.vmap(lambda g: g.kl(prior)))(several)
    np.testing.assert_allclose(eqx.filter_jit(several.kl)(prior), expected, rtol=1e-6)

    tangents = _gaussian(3, (5, 3))
    expected = jax.jit(jax.vmap(single.fisher_product))(tangents)
    actual = eqx.filter_jit(single.fisher_product)(tangents)
    np.testing.assert_allclose(actual.mean, expected.mean, rtol=1e-6)
    np.testing.assert_allclose(actual.log_std, expected.log_std, rtol=1e-6)
    assert single.sample_from_noise(values).shape == values.shape


def test_an_event_of_another_dimension_is_refused() -> None:
    gaussian = _gaussian(0, (4, 3))
    with pytest.raises(ValueError, match="last axis"):
        gaussian.log_prob(_value(0, (4, 1)))
    with pytest.raises(ValueError, match="last axis"):
        gaussian.kl(DiagonalGaussian.standard((4, 1)))


def test_mean_and_log_std_of_different_shapes_are_refused() -> None:
    # Called by itself, because the run-time checks of the tests refuse the constructor's arguments.
    mixed = eqx.tree_at(lambda g: g.log_std, _gaussian(0, (4, 3)), jnp.zeros(3))
    with pytest.raises(ValueError, match="`mean` and `log_std` must have the same shape"):
        mixed.__check_init__()
