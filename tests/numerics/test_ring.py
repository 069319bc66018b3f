"""The ring of the last rows against a Python list."""

from collections import deque

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maesn.numerics import Ring

FEATURES = 2
extend, moments = jax.jit(Ring.extend), jax.jit(Ring.moments)


def held(ring: Ring) -> list[list[float]]:
    """The rows of a ring in the order in which they came."""
    rows, size, count = np.asarray(ring.rows), int(ring.size), int(ring.count)
    return [rows[n % ring.capacity].tolist() for n in range(count - size, count)]


@pytest.mark.parametrize("capacity", [1, 3, 7, 50])
def test_it_holds_what_a_list_of_bounded_length_holds(capacity: int) -> None:
    rng = np.random.default_rng(capacity)
    ring, expected, count = Ring.empty(capacity, jnp.zeros(FEATURES)), deque(maxlen=capacity), 0
    for _ in range(8):
        # Batches that are larger than the ring, too; what is not valid is garbage.
        rows = rng.normal(size=(11, FEATURES)).astype(np.float32)
        valid = rng.random(11) < 0.6
        rows[~valid] = np.nan
        ring = extend(ring, jnp.asarray(rows), jnp.asarray(valid))
        expected.extend(rows[valid].tolist())
        count += valid.sum()
        assert int(ring.count) == count
        assert int(ring.size) == len(expected)
        assert held(ring) == list(expected)


def test_nothing_valid_changes_nothing() -> None:
    ring = extend(
        Ring.empty(3, jnp.zeros(FEATURES)), jnp.ones((2, FEATURES)), jnp.array([True, True])
    )
    same = extend(ring, jnp.full((4, FEATURES), jnp.nan), jnp.zeros(4, bool))
    for old, new in zip(jax.tree.leaves(ring), jax.tree.leaves(same), strict=True):
        np.testing.assert_array_equal(old, new)


@pytest.mark.parametrize("number", [3, 20])
def test_moments_are_those_of_the_rows_that_are_held(number: int) -> None:
    rows = np.random.default_rng(0).normal(3.0, 2.0, (number, FEATURES)).astype(np.float32)
    rows[:, 1] = 5.0
    ring = extend(Ring.empty(8, jnp.zeros(FEATURES)), jnp.asarray(rows), jnp.ones(number, bool))
    mean, std = moments(ring)
    last = rows[-8:]
    np.testing.assert_allclose(mean, last.mean(0), rtol=1e-6)
    # A feature that does not vary has no scale of its own.
    np.testing.assert_allclose(std, [last[:, 0].std(), 1.0], rtol=1e-5)


def test_an_empty_ring_has_the_moments_of_nothing() -> None:
    mean, std = moments(Ring.empty(4, jnp.zeros(FEATURES)))
    np.testing.assert_array_equal(mean, np.zeros(FEATURES))
    np.testing.assert_array_equal(std, np.ones(FEATURES))
    np.testing.assert_array_equal(
        Ring.empty(4, jnp.zeros(1)).sample(jax.random.key(0), 2), np.zeros((2, 1))
    )


def test_every_row_that_is_held_is_drawn_equally_often() -> None:
    ring = extend(Ring.empty(10, jnp.zeros(1)), jnp.arange(1.0, 5.0)[:, None], jnp.ones(4, bool))
    drawn, number = np.asarray(ring.sample(jax.random.key(0), 4000))[:, 0], 4000
    counts = np.array([(drawn == value).sum() for value in range(5)])
    assert counts[0] == 0  # of the places that are empty
    # Four sigmas of a binomial count.
    np.testing.assert_allclose(counts[1:], number / 4, atol=4 * np.sqrt(number * 3 / 16))
