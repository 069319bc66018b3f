"""What PEARL believes of a task: the product of the factors of all transitions."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from jax.test_util import check_grads

from maesn.learners.pearl.encoder import ContextEncoder, EncoderSettings
from maesn.learners.pearl.meta_learner import divergence


@cache
def encoder() -> ContextEncoder:
    return EncoderSettings(3, (8,)).init(jax.random.key(3), 2, 1)


def context(number: int) -> jax.Array:
    return jax.random.normal(jax.random.key(number), (number, 4))


def test_the_posterior_is_the_product_of_the_densities_of_all_factors() -> None:
    one, seen = encoder(), context(5)
    posterior = one(seen, jnp.ones(5, bool)).posterior()
    outputs = np.float64(jax.vmap(one.mlp)(seen))
    mean, std = outputs[:, :3], np.sqrt(np.log1p(np.exp(outputs[:, 3:])))
    for d in range(3):
        x = np.linspace(-20.0, 20.0, 200_001)
        log_product = sum(scipy.stats.norm.logpdf(x, mean[n, d], std[n, d]) for n in range(5))
        density = np.exp(log_product - log_product.max())
        density /= density.sum()
        expected = (density * x).sum()
        assert float(posterior.mean[d]) == pytest.approx(expected, rel=1e-3, abs=1e-4)
        spread = np.sqrt((density * (x - expected) ** 2).sum())
        assert float(jnp.exp(posterior.log_std[d])) == pytest.approx(spread, rel=1e-3)


def test_the_order_of_transitions_and_their_split_into_episodes_do_not_matter() -> None:
    one, seen = encoder(), context(7)
    order = np.random.default_rng(0).permutation(7)
    whole = one(seen, jnp.ones(7, bool))
    shuffled = one(seen[order], jnp.ones(7, bool))
    parts = one(seen[:3], jnp.ones(3, bool)).times(one(seen[3:], jnp.ones(4, bool)))
    masked = one(jnp.concatenate([seen, context(2)]), jnp.arange(9) < 7)
    for other in (shuffled, parts, masked):
        for x, y in zip(whole, other, strict=True):
            np.testing.assert_allclose(x, y, rtol=1e-5, atol=1e-5)


def test_nothing_seen_is_the_prior() -> None:
    posterior = encoder().none(2).posterior()
    np.testing.assert_array_equal(posterior.mean, jnp.zeros((2, 3)))
    np.testing.assert_array_equal(posterior.log_std, jnp.zeros((2, 3)))
    np.testing.assert_array_equal(divergence(posterior), jnp.zeros(2))


def test_gradients_through_the_posterior_equal_finite_differences(x64: None) -> None:
    one = jax.tree.map(lambda x: x.astype(jnp.float64), encoder())
    seen = jnp.asarray(context(5), jnp.float64)

    def loss(one: Any) -> Any:
        posterior = one(seen, jnp.ones(5, bool)).posterior()
        drawn = posterior.distribution.sample_from_noise(jnp.asarray([0.3, -1.0, 0.5]))
        return jnp.sum(drawn**2) + 0.3 * divergence(posterior)

    check_grads(jax.jit(loss), (one,), order=1, modes=["rev"], eps=1e-6)
