"""The compilation cache."""

from pathlib import Path

import jax
import pytest

from maesn.runs.process import (
    cache_directory,
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


def test_the_default_cache_is_the_users() -> None:
    assert cache_directory({}) == Path.home() / ".cache" / "maesn"


def test_without_a_cache_nothing_is_configured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAESN_CACHE", "off")
    before = jax.config.jax_compilation_cache_dir
    enable_compilation_cache()
    assert jax.config.jax_compilation_cache_dir == before
