"""Two computations at the same time."""

import threading

import jax
import jax.numpy as jnp
import pytest

from maesn.numerics import at_once


@pytest.mark.usefixtures("x64")
def test_two_calls_at_once_meet_and_raise_what_either_raises() -> None:
    """Each waits for the other, so that one after the other would never end."""
    meeting = threading.Barrier(2, timeout=60)

    def half(number: float) -> jax.Array:
        meeting.wait()
        return jnp.asarray(number)

    found = at_once(lambda: half(1.0), lambda: half(2.0))
    assert found == (1.0, 2.0)
    assert [x.dtype for x in found] == ["float64", "float64"]
    with pytest.raises(ZeroDivisionError):
        at_once(lambda: jnp.zeros(()), lambda: jnp.asarray(1 / 0))
