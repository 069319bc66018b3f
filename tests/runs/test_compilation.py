"""The compilation cache and the compilation clock."""

import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import pytest

from maesn.runs.compilation import (
    CompileClock,
    cache_directory,
    covered,
    enable_compilation_cache,
)


@pytest.mark.parametrize(
    ("environment", "wanted"),
    [
        ({"MAESN_CACHE": "/x"}, Path("/x")),
        ({"MAESN_CACHE": "/x", "XDG_CACHE_HOME": "/y"}, Path("/x")),
        ({"MAESN_CACHE": ""}, None),
        ({"MAESN_CACHE": "0"}, None),
        ({"MAESN_CACHE": "off", "XDG_CACHE_HOME": "/y"}, None),
        ({"XDG_CACHE_HOME": "/y", "HOME": "/h"}, Path("/y/maesn")),
    ],
)
def test_where_compiled_programs_are_kept(environment: dict[str, str], wanted: Path | None) -> None:
    assert cache_directory(environment) == wanted


def test_the_default_cache_is_the_users(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    assert cache_directory({"HOME": "/h"}) == Path("/h/.cache/maesn")
    monkeypatch.setattr(sys, "platform", "darwin")
    assert cache_directory({"HOME": "/h"}) == Path("/h/Library/Caches/maesn")


def test_without_a_cache_nothing_is_configured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAESN_CACHE", "off")
    before = jax.config.jax_compilation_cache_dir
    assert enable_compilation_cache() is None
    assert jax.config.jax_compilation_cache_dir == before


def test_the_clock_counts_compilation_alone() -> None:
    function = jax.jit(lambda x: jax.numpy.linalg.svd(x @ x)[0])
    x = jax.numpy.ones((3, 3))
    with CompileClock() as first:
        function(x).block_until_ready()
    with CompileClock() as second:
        function(x).block_until_ready()
    assert first.seconds > 0
    assert second.seconds == 0


@pytest.mark.parametrize(
    ("spans", "wanted"),
    [
        ([], 0.0),
        ([(1.0, 2.0), (3.0, 5.0)], 3.0),
        ([(1.0, 3.0), (2.0, 5.0)], 4.0),
        # In the order in which they end: the last one covers the others.
        ([(1.0, 2.0), (3.0, 4.0), (0.5, 6.0)], 5.5),
        ([(1.0, 4.0), (2.0, 3.0), (3.5, 3.6)], 3.0),
    ],
)
def test_what_overlaps_counts_once(spans: list[tuple[float, float]], wanted: float) -> None:
    assert covered(spans) == pytest.approx(wanted)


def test_threads_that_compile_together_take_no_longer_than_the_clock_ran() -> None:
    def compile_one(size: float) -> None:
        jax.jit(lambda x: jax.numpy.linalg.svd(x @ x * size)[0])(jax.numpy.ones((3, 3)))

    begin = time.perf_counter()
    with CompileClock() as clock, ThreadPoolExecutor(4) as pool:
        list(pool.map(compile_one, (1.0, 2.0, 3.0, 4.0)))
    assert 0 < clock.seconds <= time.perf_counter() - begin
