"""What is kept under `results/`: small, readable, and what its tables say."""

import csv
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from scripts import ROOT, load_script
from small_runs import create, tiny_maesn

from maesn.evaluation.evaluation import Evaluation
from maesn.report.reading import read_adaptation
from maesn.runs.config import read_config
from maesn.runs.run import Run
from maesn.storage import RunError

RESULTS = ROOT / "results"
RUNS = sorted(path.parent for path in RESULTS.rglob("config.json"))
# Families of these runs are examples, which the tests of examples import.
HOSTED = ("half_cheetah_velocity", "metaworld_reach")
TABLES = sorted(RESULTS.rglob("test-sparse.csv"))
MOST_BYTES = 4 * 2**20


def name_of(path: Path) -> str:
    return path.relative_to(RESULTS).as_posix()


def test_results_stay_small() -> None:
    files = [path for path in RESULTS.rglob("*") if path.is_file()]
    # As a file system counts: in blocks.
    assert sum(math.ceil(path.stat().st_size / 4096) * 4096 for path in files) < MOST_BYTES


@pytest.mark.parametrize("directory", RUNS, ids=name_of)
def test_every_run_can_be_opened_and_its_policy_loaded(directory: Path) -> None:
    if name_of(directory).startswith(HOSTED):
        family = read_config(directory).family
        with pytest.raises(RunError, match=f"the run's family `{family}` does not come with"):
            Run.open(directory)
        return
    run = Run.open(directory)
    assert run.latest().iteration == run.settings.iterations
    assert [line["iteration"] for line in run.metrics()] == list(range(1, 21))


@pytest.mark.parametrize("table", TABLES, ids=name_of)
def test_tables_are_tabulated_as_they_say(table: Path) -> None:
    """Of three seeds together, `tables.md` says other numbers than each table alone."""
    run = table.parents[1]
    means = read_adaptation(table).mean_return.mean(0)
    said = (run.parent / "tables.md").read_text(encoding="utf-8")
    seeds = len(list(run.parent.glob(f"{run.name.rsplit('-', 1)[0]}-*/adaptation/*.csv")))
    part = said.split(f"**{run.name.rsplit('-seed-', 1)[0]}, seeds: {seeds}**")[1]
    row = next(line for line in part.splitlines() if line.startswith("| 10 |"))
    if seeds == 1:
        assert row.split("|")[3].split()[0] == f"{means[-1]:.1f}"
    else:
        all_seeds = [
            read_adaptation(one).mean_return[:, -1].mean()
            for one in run.parent.glob(f"{run.name.rsplit('-', 1)[0]}-*/adaptation/*.csv")
        ]
        assert row.split("|")[3].split()[0] == f"{np.mean(all_seeds):.1f}"


@pytest.mark.parametrize(("directory", "reward"), [(".", "0"), ("reward_elsewhere", "-1")])
def test_what_is_said_of_the_chain_is_what_its_tables_say(directory: str, reward: str) -> None:
    said = (RESULTS / "vime_chain" / "README.md").read_text(encoding="utf-8")
    with (RESULTS / "vime_chain" / directory / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    part = said[said.index(f"| {reward} | `trpo`") :]
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


@pytest.mark.long
def test_every_configuration_has_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    create(tmp_path / "runs" / "maesn", tiny_maesn())
    tuning = load_script("results/tuning.py")
    small = Evaluation(tasks="validation", num_tasks=3, episodes=8, episodes_per_update=2)
    monkeypatch.setattr(tuning, "TRAINED", small)
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
