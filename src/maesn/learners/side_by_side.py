"""Compiled programs that do not wait for each other."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any


def side_by_side(*programs: Callable[[], Any]) -> list[Any]:
    """Return what each of several programs returns.

    Networks that are unrolled step by step, or trained on a few samples at a time, consist of
    products too small for more than one core. On a CPU, JAX computes what one thread asks for one
    after the other, so each program is asked for by a thread of its own. What a `with` block sets
    for JAX in the calling thread (`jax.default_device`, say) does not hold there.

    Args:
        programs: call compiled functions.
    """
    with ThreadPoolExecutor(len(programs)) as pool:
        asked = [pool.submit(program) for program in programs]
        return [one.result() for one in asked]
