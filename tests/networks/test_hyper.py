"""A hypernetwork: its start, the weights that it makes, and their derivatives."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from maesn.networks import HyperMLP, hyper_mlp, init_mlp

INPUTS, CONDITION, HIDDEN, OUTPUTS = 3, 4, 5, 2


def arrays(*sizes: int) -> list[jax.Array]:
    stream = np.random.default_rng(0)
    return [jnp.asarray(stream.normal(size=size), float) for size in sizes]


def moved() -> HyperMLP:
    """A hypernetwork whose weights depend on the condition, biases too."""
    start = hyper_mlp(init_mlp(jax.random.key(0), (INPUTS, HIDDEN, OUTPUTS)), CONDITION)
    leaves, structure = jax.tree.flatten(start)
    stream = np.random.default_rng(1)
    noisy = [jnp.asarray(x + 0.5 * stream.normal(size=x.shape), float) for x in leaves]
    return jax.tree.unflatten(structure, noisy)


def test_at_the_start_all_conditions_share_the_weights_of_one_network() -> None:
    mlp = init_mlp(jax.random.key(0), (INPUTS, HIDDEN, OUTPUTS))
    start, (condition,) = hyper_mlp(mlp, CONDITION), arrays(CONDITION)
    jax.tree.map(np.testing.assert_array_equal, start.weights(condition), mlp)
    # But a gradient step tells them apart.
    (x,) = arrays(INPUTS)
    gradient = jax.grad(lambda hyper: hyper(x, condition).sum())(start)
    after = jax.tree.map(jnp.add, start, gradient)
    assert np.abs(after(x, condition) - after(x, -condition)).max() > 0.1


def test_it_is_the_formula_written_out() -> None:
    hyper, (x, condition) = moved(), arrays(INPUTS, CONDITION)
    value = np.asarray(x)
    for number, (bias, slope) in enumerate(zip(hyper.bias.layers, hyper.slope.layers, strict=True)):
        weight = bias.weight + sum(condition[k] * slope.weight[k] for k in range(CONDITION))
        shift = bias.bias + sum(condition[k] * slope.bias[k] for k in range(CONDITION))
        value = (value if number == 0 else np.maximum(value, 0.0)) @ weight + shift
    np.testing.assert_allclose(hyper(x, condition), value, rtol=1e-5)


@pytest.mark.usefixtures("x64")
def test_derivatives_equal_finite_differences() -> None:
    def output(*given: Any) -> jax.Array:
        hyper, x, condition = jax.tree.map(jnp.asarray, given)  # which differences are not
        return jnp.sin(hyper(x, condition)).sum()

    check_grads(output, (moved(), *arrays(INPUTS, CONDITION)), order=1, eps=1e-6)
