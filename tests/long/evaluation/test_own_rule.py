"""The guide's commands for a rule of one's own do what they say."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from guides import Guide

GUIDE = Guide("own_rule.md", "my_rules")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Where the guide's file is, and can be imported from."""
    directory = tmp_path_factory.mktemp("own_rule")
    GUIDE.write(directory)
    sys.path.insert(0, str(directory))
    yield directory
    sys.path.remove(str(directory))
    del sys.modules["my_rules"]


def test_its_commands_do_what_they_say(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    GUIDE.follow("adapt", "compare", more=["--num-tasks", "2"])
    tables = folder / "maesn-wheeled" / "adaptation"
    written = sorted(tables.glob("test-sparse-*.csv"))
    # With other settings of the rule the table is another one.
    assert len(written) == 2
    assert all(path.name.startswith("test-sparse-crossentropy-") for path in written)
    assert (folder / "cross-entropy" / "comparison.png").exists()
    assert "MAESN (CrossEntropy)" in (folder / "cross-entropy" / "summary.md").read_text()
