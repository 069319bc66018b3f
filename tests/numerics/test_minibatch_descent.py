"""First-order optimisation against Adam written out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maesn.numerics import MinibatchDescent

TARGETS = np.float32([[1.0, 2.0], [3.0, 0.0], [-1.0, 4.0], [5.0, 6.0]])


def loss(x: jax.Array, batch: jax.Array) -> tuple[jax.Array, jax.Array]:
    return 0.5 * jnp.mean(jnp.sum((x[None] - batch) ** 2, axis=-1)), batch.sum()


def adam(x: np.ndarray, steps: int, rate: float, largest: float) -> np.ndarray:
    """Kingma and Ba, algorithm 1, on the full batch, with gradients cut to a norm."""
    first, second = np.zeros(2), np.zeros(2)
    for t in range(1, steps + 1):
        gradient = x - TARGETS.mean(0)
        gradient = gradient * min(1.0, largest / np.linalg.norm(gradient))
        first, second = 0.9 * first + 0.1 * gradient, 0.999 * second + 0.001 * gradient**2
        x = x - rate * (first / (1 - 0.9**t)) / (np.sqrt(second / (1 - 0.999**t)) + 1e-8)
    return x


@pytest.mark.parametrize("largest", [0.5, 100.0])
def test_one_minibatch_is_adam(largest: float) -> None:
    descent = MinibatchDescent(0.1, epochs=5, minibatches=1, max_gradient_norm=largest)
    x = jnp.asarray([0.3, -0.2])
    moved, _, _ = descent.run(jax.random.key(0), x, descent.init(x), loss, jnp.asarray(TARGETS))
    np.testing.assert_allclose(moved, adam(np.array([0.3, -0.2]), 5, 0.1, largest), rtol=1e-4)


def test_the_state_goes_on() -> None:
    """Two runs of two passes are one of four."""
    x, data = jnp.asarray([0.3, -0.2]), jnp.asarray(TARGETS)
    two, four = (MinibatchDescent(0.1, epochs=n, minibatches=1) for n in (2, 4))
    whole, _, _ = four.run(jax.random.key(0), x, four.init(x), loss, data)
    half, state, _ = two.run(jax.random.key(0), x, two.init(x), loss, data)
    parts, _, _ = two.run(jax.random.key(1), half, state, loss, data)
    np.testing.assert_allclose(parts, whole, rtol=1e-5)


def test_every_sample_is_used_once_in_a_pass() -> None:
    """The mean over minibatches of a batch's sum is the sum of all over their number."""
    descent = MinibatchDescent(epochs=3, minibatches=2)
    x = jnp.zeros(2)
    _, _, last = descent.run(jax.random.key(0), x, descent.init(x), loss, jnp.asarray(TARGETS))
    assert float(last) == pytest.approx(TARGETS.sum() / 2)


def test_too_few_samples_are_refused() -> None:
    descent = MinibatchDescent(minibatches=5)
    with pytest.raises(ValueError, match="`minibatches` is 5, but there are only 4 samples"):
        descent.run(
            jax.random.key(0), jnp.zeros(2), descent.init(jnp.zeros(2)), loss, jnp.asarray(TARGETS)
        )
