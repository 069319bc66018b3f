"""Two computations at the same time."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import jax

First = TypeVar("First")
Second = TypeVar("Second")


def at_once(first: Callable[[], First], second: Callable[[], Second]) -> tuple[First, Second]:
    """Return what two calls of compiled functions return, each computed on its own thread.

    On a CPU, XLA computes a program of small products on one core. Of JAX's settings in `with`
    blocks, the second call's thread takes over `enable_x64` alone.
    """
    wide = jax.config.jax_enable_x64  # type: ignore[attr-defined]

    def compute() -> Second:
        with jax.enable_x64(wide):  # a thread does not inherit it from a `with` block
            return jax.block_until_ready(second())  # type: ignore[no-untyped-call]

    with ThreadPoolExecutor(1) as pool:
        other = pool.submit(compute)
        own: First = jax.block_until_ready(first())  # type: ignore[no-untyped-call]
        return own, other.result()
