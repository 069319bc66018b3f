"""The compilation cache and the compilation clock."""

import sys
from pathlib import Path

import jax
import pytest

from maesn.runs.compilation import (
    cache_directory,
    compile_seconds,
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
    enable_compilation_cache()
    assert jax.config.jax_compilation_cache_dir == before


def test_compilation_alone_is_counted() -> None:
    function = jax.jit(lambda x: jax.numpy.linalg.svd(x @ x)[0])
    x = jax.numpy.ones((3, 3))
    before = compile_seconds()
    function(x).block_until_ready()
    after = compile_seconds()
    function(x).block_until_ready()
    assert compile_seconds() == after > before
