"""The cache of compiled programs."""

from pathlib import Path

import jax
import pytest

from maesn.runs.process import enable_compilation_cache

HOME = Path.home() / ".cache" / "maesn"


@pytest.mark.parametrize(
    ("variables", "wanted"),
    [
        ({}, HOME),
        ({"XDG_CACHE_HOME": "/y"}, Path("/y/maesn")),
        ({"XDG_CACHE_HOME": "/y", "JAX_COMPILATION_CACHE_DIR": "/x"}, Path("/x")),
    ],
)
def test_where_compiled_programs_are_kept(
    variables: dict[str, str], wanted: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("XDG_CACHE_HOME", "JAX_COMPILATION_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    enable_compilation_cache()
    assert Path(jax.config.values["jax_compilation_cache_dir"]) == wanted
