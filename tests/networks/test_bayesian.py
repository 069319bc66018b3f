"""The Bayesian network: its draws, its divergences, and the information gain."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maesn.networks import BayesianNetwork, init_bayesian_network

INPUTS, OUTPUTS = 3, 2


def network(seed: int, hidden: tuple[int, ...] = (4,)) -> BayesianNetwork:
    """A network whose weights are nowhere special."""
    fresh = init_bayesian_network(jax.random.key(seed), (INPUTS, *hidden, OUTPUTS), 0.5)
    leaves, structure = jax.tree.flatten(fresh)
    keys = jax.random.split(jax.random.key(seed + 100), len(leaves))
    moved = [
        leaf + 0.5 * jax.random.normal(key, leaf.shape)
        for leaf, key in zip(leaves, keys, strict=True)
    ]
    return jax.tree.unflatten(structure, moved)


def draw_weights(model: BayesianNetwork, rng: np.random.Generator, number: int) -> list[np.ndarray]:
    """Whole sets of weights, drawn one by one: layer after layer, weight and bias."""
    drawn = []
    for mean, rho in zip(jax.tree.leaves(model.mean), jax.tree.leaves(model.rho), strict=True):
        std = np.log1p(np.exp(np.asarray(rho)))
        drawn.append(np.asarray(mean) + std * rng.normal(size=(number, *mean.shape)))
    return drawn


def test_every_weight_starts_with_the_standard_deviation_that_is_asked_for() -> None:
    fresh = init_bayesian_network(jax.random.key(0), (INPUTS, 4, OUTPUTS), 0.3)
    np.testing.assert_allclose(np.exp(fresh.posterior.log_std), 0.3, rtol=1e-6)


@pytest.mark.parametrize("hidden", [(), (4,)])
def test_drawing_units_is_drawing_weights(hidden: tuple[int, ...]) -> None:
    model, number, x = network(0, hidden), 20_000, np.array([0.5, -1.0, 2.0])
    values = np.tile(x, (number, 1))
    weights = draw_weights(model, np.random.default_rng(0), number)
    *hidden_layers, last = zip(weights[::2], weights[1::2], strict=True)
    for weight, bias in hidden_layers:
        values = np.maximum(np.einsum("ni,nio->no", values, weight) + bias, 0.0)
    expected = np.einsum("ni,nio->no", values, last[0]) + last[1]
    noise = jax.random.normal(jax.random.key(1), (number, model.noise_size))
    found = jax.jit(jax.vmap(model, in_axes=(None, 0)))(jnp.asarray(x), noise)
    # Outputs share the hidden units, so that not only the marginals must agree.
    statistics = (lambda y: y[:, 0], lambda y: y[:, 0] ** 2, lambda y: np.prod(y, axis=1))
    for statistic in statistics:
        one, other = statistic(expected), statistic(np.asarray(found))
        error = np.hypot(one.std(), other.std()) / np.sqrt(number)
        assert abs(one.mean() - other.mean()) < 4 * error


def test_the_divergence_is_that_of_every_weight_summed() -> None:
    one, other = network(0), network(1)
    total = 0.0
    parts = (one.mean, one.rho, other.mean, other.rho)
    for mean, rho, mean_, rho_ in zip(*map(jax.tree.leaves, parts), strict=True):
        std, std_ = np.log1p(np.exp(rho)), np.log1p(np.exp(rho_))
        total += np.sum(np.log(std_ / std) + (std**2 + (mean - mean_) ** 2) / (2 * std_**2) - 0.5)
    np.testing.assert_allclose(one.posterior.kl(other.posterior), total, rtol=1e-5)


def gradient_of_one_transition(model: BayesianNetwork) -> BayesianNetwork:
    x, y = jnp.array([0.5, -1.0, 2.0]), jnp.array([1.0, -0.5])
    noise = jax.random.normal(jax.random.key(5), (7, model.noise_size))

    def surprise(moved: BayesianNetwork) -> jax.Array:
        predicted = jax.vmap(moved, in_axes=(None, 0))(x, noise)
        return 2.0 * jnp.mean(jnp.sum((predicted - y[None]) ** 2, axis=-1))

    return jax.jit(jax.grad(surprise))(model)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("hidden", [(), (4,)])
def test_the_information_gain_is_the_divergence_after_a_newton_step(
    hidden: tuple[int, ...],
) -> None:
    model = network(2, hidden)
    gradient = gradient_of_one_transition(model)
    flat, unravel = jax.flatten_util.ravel_pytree(model)
    slope = jax.flatten_util.ravel_pytree(gradient)[0]

    def divergence(x: jax.Array) -> jax.Array:
        return unravel(x).posterior.kl(model.posterior)

    newton = jax.jit(lambda: jnp.linalg.solve(jax.hessian(divergence)(flat), slope))()
    # To second order, it is the divergence's own Taylor polynomial.
    gain = model.information_gain(gradient)
    np.testing.assert_allclose(gain, 0.5 * slope @ newton, rtol=1e-10)

    def error(step_size: float) -> jax.Array:
        exact = divergence(flat - step_size * newton)
        return abs(model.information_gain(gradient, step_size) / exact - 1)

    errors = jax.jit(lambda: jnp.stack([error(size) for size in (1e-2, 1e-3, 1e-4)]))()
    # What is left is of the third order, ten times less for a tenth of the step.
    assert errors[0] < 0.5
    assert errors[2] < 2e-3
    np.testing.assert_allclose(np.divide(errors[1:], errors[:-1]), 0.1, rtol=0.3)


def test_a_standard_deviation_is_positive_however_small_rho() -> None:
    model = network(0)
    tiny = BayesianNetwork(model.mean, jax.tree.map(lambda x: jnp.full_like(x, -30.0), model.rho))
    np.testing.assert_allclose(tiny.posterior.log_std, -30.0, rtol=1e-5)
    assert np.isfinite(tiny.information_gain(gradient_of_one_transition(tiny)))
