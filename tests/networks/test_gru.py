"""Gated recurrent units against a NumPy loop and against Equinox's cell."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maesn.networks import GRU, init_gru

INPUTS, HIDDEN, STEPS = 3, 4, 6


def random_gru() -> GRU:
    """All parameters random, biases too."""
    gru = init_gru(jax.random.key(0), INPUTS, HIDDEN)
    leaves, structure = jax.tree.flatten(gru)
    keys = jax.random.split(jax.random.key(1), len(leaves))
    noisy = [x + 0.3 * jax.random.normal(k, x.shape) for x, k in zip(leaves, keys, strict=True)]
    return jax.tree.unflatten(structure, noisy)


def random_inputs() -> tuple[np.ndarray, np.ndarray]:
    stream = np.random.default_rng(0)
    x = stream.normal(size=(STEPS, INPUTS)).astype(np.float32)
    return x, stream.normal(size=HIDDEN).astype(np.float32)


def loop(gru: GRU, x: np.ndarray, hidden: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """The equations of the docstring, gate by gate, in double precision."""
    w_r, w_u, w_n = np.split(np.float64(gru.inputs.weight), 3, axis=1)
    b_r, b_u, b_n = np.split(np.float64(gru.inputs.bias), 3)
    u_r, u_u, u_n = np.split(np.float64(gru.recurrent), 3, axis=1)
    c, states, h = np.float64(gru.candidate_bias), [], np.float64(hidden)
    for t in range(len(x)):
        if valid[t]:
            r = 1 / (1 + np.exp(-(x[t] @ w_r + b_r + h @ u_r)))
            u = 1 / (1 + np.exp(-(x[t] @ w_u + b_u + h @ u_u)))
            n = np.tanh(x[t] @ w_n + b_n + r * (h @ u_n + c))
            h = (1 - u) * n + u * h
        states.append(h)
    return np.stack(states)


def test_unroll_is_a_numpy_loop_and_keeps_memory_where_invalid() -> None:
    gru, (x, hidden) = random_gru(), random_inputs()
    for valid in (np.ones(STEPS, bool), np.array([True, True, False, False, True, False])):
        states, last = gru.unroll(jnp.asarray(x), jnp.asarray(valid), jnp.asarray(hidden))
        expected = loop(gru, x, hidden, valid)
        np.testing.assert_allclose(states, expected, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(last, expected[-1], rtol=1e-5, atol=1e-6)


def test_one_step_is_that_of_equinox() -> None:
    gru, (x, hidden) = random_gru(), random_inputs()
    cell = eqx.tree_at(
        lambda c: (c.weight_ih, c.weight_hh, c.bias, c.bias_n),
        eqx.nn.GRUCell(INPUTS, HIDDEN, key=jax.random.key(0)),
        (gru.inputs.weight.T, gru.recurrent.T, gru.inputs.bias, gru.candidate_bias),
    )
    mine = gru(jnp.asarray(x[0]), jnp.asarray(hidden))
    np.testing.assert_allclose(mine, cell(jnp.asarray(x[0]), jnp.asarray(hidden)), rtol=1e-5)


def test_the_start_is_orthogonal_gate_by_gate() -> None:
    gru = init_gru(jax.random.key(0), INPUTS, HIDDEN)
    for gate in jnp.split(gru.recurrent, 3, axis=1):
        np.testing.assert_allclose(gate.T @ gate, np.eye(HIDDEN), atol=1e-5)


@pytest.mark.usefixtures("x64")
def test_derivatives_are_those_of_a_plain_loop() -> None:
    gru = jax.tree.map(lambda leaf: leaf.astype(float), random_gru())
    x, hidden = (jnp.asarray(given, float) for given in random_inputs())
    valid = jnp.array([True, True, False, True, True, False])

    def looped(gru: GRU, x: jax.Array, hidden: jax.Array) -> jax.Array:
        states = []
        for t in range(STEPS):
            hidden = jnp.where(valid[t], gru(x[t], hidden), hidden)
            states.append(hidden)
        return jnp.sin(jnp.stack(states)).sum()

    def unrolled(gru: GRU, x: jax.Array, hidden: jax.Array) -> jax.Array:
        return jnp.sin(gru.unroll(x, valid, hidden)[0]).sum()

    given = (gru, x, hidden)
    mine, plain = (jax.jit(jax.grad(f, argnums=(0, 1, 2)))(*given) for f in (unrolled, looped))
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-10, atol=1e-12), mine, plain)
    # Forward mode, which the curvature of a trust region takes.
    mine, plain = (jax.jit(partial(jax.jvp, f))(given, plain)[1] for f in (unrolled, looped))
    np.testing.assert_allclose(mine, plain, rtol=1e-10)
