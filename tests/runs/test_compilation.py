"""The compilation cache."""

from pathlib import Path

import pytest

from maesn.runs.process import cache_directory


@pytest.mark.parametrize(
    ("environment", "wanted"),
    [
        ({"MAESN_CACHE": "/x"}, Path("/x")),
        ({"MAESN_CACHE": "/x", "XDG_CACHE_HOME": "/y"}, Path("/x")),
        ({"MAESN_CACHE": ""}, None),
        ({"MAESN_CACHE": "0"}, None),
        ({"MAESN_CACHE": "off", "XDG_CACHE_HOME": "/y"}, None),
        ({"XDG_CACHE_HOME": "/y", "HOME": "/h"}, Path("/y/maesn")),
        ({}, Path.home() / ".cache" / "maesn"),
    ],
)
def test_where_compiled_programs_are_kept(environment: dict[str, str], wanted: Path | None) -> None:
    assert cache_directory(environment) == wanted
