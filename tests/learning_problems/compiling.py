"""Learners are small in the tests and run for milliseconds, but compile for seconds."""

from collections.abc import Iterator

import jax
import pytest


@pytest.fixture
def quick_compilation() -> Iterator[None]:
    """Leave most of the compiler's optimisations out: half the time, the same mathematics."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)
