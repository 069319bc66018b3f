"""The tables under `results/` are what the runs beside them say."""

import csv
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from scripts import ROOT, load_script
from small_runs import create, tiny_maesn

from maesn.studies.curves import Conditions

RESULTS = ROOT / "results"
TABULATED = sorted(path.parent for path in RESULTS.rglob("tables.md"))


def test_there_are_tables() -> None:
    names = {directory.relative_to(RESULTS).as_posix() for directory in TABULATED}
    assert {"ant", "blockpush", "wheeled", "wheeled/ablation/runs"} <= names


@pytest.mark.parametrize(
    "directory", TABULATED, ids=lambda path: path.relative_to(RESULTS).as_posix()
)
def test_tables_are_those_of_the_runs(
    directory: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["summarize.py", str(directory)])
    load_script("results/summarize.py").main()
    assert capsys.readouterr().out == (directory / "tables.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(("directory", "pay"), [(".", "0"), ("paid_elsewhere", "-1")])
def test_what_is_said_of_the_chain_is_what_its_tables_say(directory: str, pay: str) -> None:
    said = (RESULTS / "vime_chain" / "README.md").read_text(encoding="utf-8")
    with (RESULTS / "vime_chain" / directory / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    part = said[said.index(f"| {pay} | `trpo`") :]
    for name in ("trpo", "reinforce", "random_bonus", "vime"):
        seeds = [row for row in rows if row["method"] == name]
        runs, found, early = (
            sum(int(row[key]) for row in seeds) for key in ("runs", "found", "found_early")
        )
        lucky = sum(int(row["found"]) > 0 for row in seeds)
        success = np.mean([float(row["final_success_rate"]) for row in seeds])
        cells = f"{found} of {runs} | {early} | {lucky} of {len(seeds)} | {success:.2f} |"
        assert f"| `{name}` | {cells}" in "\n".join(part.splitlines()[:4])


def test_a_default_configuration_stays_unless_another_is_better_beyond_chance() -> None:
    tuning = load_script("results/tuning.py")
    default = np.array([-10.0, -20.0, -30.0, -40.0])
    # On average 1 better, with a standard error of the difference of 2.3.
    hardly = default + np.array([5.0, -3.0, 5.0, -3.0])
    clearly = default + np.array([1.5, 0.5, 1.5, 0.5])
    assert tuning.standard_error(hardly - default) == pytest.approx(4 / math.sqrt(3))
    assert tuning.chosen({"default": default, "other": hardly}) == "default"
    assert tuning.chosen({"default": default, "other": clearly}) == "other"
    assert tuning.chosen({"default": default, "other": default - 1}) == "default"


def test_every_configuration_has_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    create(tmp_path / "runs" / "maesn", tiny_maesn())
    tuning = load_script("results/tuning.py")
    small = Conditions(tasks="validation", num_tasks=3, updates=4, episodes_per_task=2)
    monkeypatch.setattr(tuning, "TRAINED_CONDITIONS", small)
    asked = [str(tmp_path / "runs"), "--out", str(tmp_path / "out"), "--only", "maesn"]
    monkeypatch.setattr(sys, "argv", ["tuning.py", *asked])
    tuning.main()
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| `maesn` ")]
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert [name.strip("*") for _, name, *_ in cells] == list(tuning.PACES)
    assert sum(name.startswith("**") for _, name, *_ in cells) == 1
    assert {(tasks, updates) for _, _, tasks, updates, *_ in cells} == {("3", "4")}
    # Only the first two of the four steps have the same size in two of them.
    assert len({returned for *_, returned, _ in cells}) == 3
