"""Choices against SciPy, and what has no counterpart there against sums over all choices."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from maesn.numerics import Categorical

# Unequal choices, equal ones, one that is all but certain, and an offset that changes nothing.
LOGITS = np.float32([[0.3, -1.2, 0.7, 0.0], [0, 0, 0, 0], [8, -8, 0, 1], [100.3, 98.8, 100.7, 100]])
OTHER = np.float32([[0.1, -1.0, 0.5, 0.4], [1, 2, 3, 4], [7, -8, 0, 1], [0, 0, 0, 0]])


def probabilities(logits: np.ndarray) -> np.ndarray:
    return scipy.special.softmax(np.float64(logits), axis=-1)


def test_entropy_and_divergence_are_those_of_scipy() -> None:
    p, q = probabilities(LOGITS), probabilities(OTHER)
    entropy = Categorical(jnp.asarray(LOGITS)).entropy()
    np.testing.assert_allclose(entropy, scipy.stats.entropy(p, axis=-1), rtol=1e-5)
    divergence = Categorical(jnp.asarray(LOGITS)).kl(Categorical(jnp.asarray(OTHER)))
    np.testing.assert_allclose(divergence, scipy.stats.entropy(p, q, axis=-1), rtol=2e-5)


def test_log_prob_is_that_of_a_multinomial_draw() -> None:
    p = probabilities(LOGITS)
    for choice in np.eye(4, dtype=np.float32):
        expected = [scipy.stats.multinomial.logpmf(choice, 1, row) for row in p]
        events = jnp.asarray(np.tile(choice, (4, 1)))
        log_prob = Categorical(jnp.asarray(LOGITS)).log_prob(events)
        np.testing.assert_allclose(log_prob, expected, rtol=1e-5, atol=1e-6)


def test_divergence_of_close_neighbours_keeps_its_digits() -> None:
    """KL = v'Fv/2 to leading order: 1e-8 here, below the rounding of a naive sum."""
    direction = np.float32([0.5, -0.3, 0.2, -0.7])
    p = probabilities(LOGITS[0])
    step = 2e-4
    expected = 0.5 * step**2 * (p @ direction**2 - (p @ direction) ** 2)
    moved = Categorical(jnp.asarray(LOGITS[0] + np.float32(step) * direction))
    assert float(Categorical(jnp.asarray(LOGITS[0])).kl(moved)) == pytest.approx(expected, rel=0.01)


def test_fisher_product_is_the_covariance_of_the_score() -> None:
    for logits in LOGITS[:3]:
        p = probabilities(logits)
        score = np.eye(4) - p  # row k: gradient of log p(k)
        fisher = np.einsum("k,ki,kj->ij", p, score, score)
        for direction in np.eye(4, dtype=np.float32):
            product = Categorical(jnp.asarray(logits)).fisher_product(
                Categorical(jnp.asarray(direction))
            )
            np.testing.assert_allclose(product.logits, fisher @ direction, rtol=1e-4, atol=1e-6)


def test_fisher_product_is_the_hessian_of_the_divergence() -> None:
    logits = jnp.asarray(LOGITS[0])
    hessian = jax.jit(jax.hessian(lambda x: Categorical(logits).kl(Categorical(x))))(logits)
    product = jax.vmap(lambda v: Categorical(logits).fisher_product(Categorical(v)).logits)
    np.testing.assert_allclose(jax.jit(product)(jnp.eye(4)), hessian, rtol=1e-4, atol=1e-6)


def test_samples_are_one_hot_and_occur_as_often_as_they_should() -> None:
    count = 100_000
    logits = jnp.broadcast_to(jnp.asarray(LOGITS[0]), (count, 4))
    noise = Categorical.noise(jax.random.key(0), logits.shape)
    drawn = np.asarray(Categorical(logits).sample_from_noise(noise))
    assert set(np.unique(drawn)) == {0.0, 1.0}
    np.testing.assert_array_equal(drawn.sum(-1), 1.0)
    p = probabilities(LOGITS[0])
    sigma = np.sqrt(p * (1 - p) / count)
    assert np.all(np.abs(drawn.mean(0) - p) < 4 * sigma)


def test_std_is_that_of_the_samples_components() -> None:
    p = probabilities(LOGITS)
    expected = np.sqrt(p * (1 - p))
    np.testing.assert_allclose(
        Categorical(jnp.asarray(LOGITS)).std(), expected, rtol=1e-4, atol=1e-6
    )
