"""The tables under `results/` are what the runs beside them say."""

import sys
from pathlib import Path

import pytest
from scripts import ROOT, load_script

TABULATED = sorted(path.parent for path in (ROOT / "results").glob("*/tables.md"))


def test_there_are_tables() -> None:
    assert {"ant", "blockpush", "wheeled"} <= {directory.name for directory in TABULATED}


@pytest.mark.parametrize("directory", TABULATED, ids=lambda directory: directory.name)
def test_tables_are_those_of_the_runs(
    directory: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["summarize.py", str(directory)])
    load_script("results/summarize.py").main()
    assert capsys.readouterr().out == (directory / "tables.md").read_text(encoding="utf-8")
