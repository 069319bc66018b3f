"""What is kept under `results/`: small, readable, and what its tables say."""

import csv
import math
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scripts import ROOT

from maesn.reporting.reading import read_adaptation
from maesn.runs.config import read_config
from maesn.runs.run import Run
from maesn.storage import RunError
from maesn.studies.jobs import DONE
from maesn.studies.members import RUN

RESULTS = ROOT / "results"
RUNS = sorted(path.parent for path in RESULTS.rglob("config.json"))
# Families of these runs are examples, which the tests of examples import.
HOSTED = ("half_cheetah_velocity", "metaworld_reach")
TABLES = sorted(RESULTS.rglob("test-sparse.csv"))
MOST_BYTES = 6 * 10**6


def name_of(path: Path) -> str:
    return path.relative_to(RESULTS).as_posix()


def test_results_stay_small() -> None:
    # Without what `maesn report results` draws there.
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "."]
    names = subprocess.run(listed, cwd=RESULTS, check=True, capture_output=True, text=True).stdout
    files = [RESULTS / name for name in names.rstrip("\0").split("\0") if (RESULTS / name).exists()]
    assert len(files) > len(RUNS)
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
    if directory.name == RUN and not (directory.parent / DONE).exists():
        assert run.latest().iteration > 0  # the study goes on with it
        return
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
