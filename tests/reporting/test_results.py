"""What is kept under `results/`: small, readable, and what its tables say."""

import csv
import math
import re
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import ROOT, prose

from maesn.reporting.report import SUMMARY
from maesn.reporting.sources import MANIFEST, compare_study, studies_in
from maesn.reporting.tables import summary_tables, to_page
from maesn.runs.run import Run
from maesn.storage import read_json
from maesn.studies.jobs import DONE
from maesn.studies.members import RUN
from maesn.studies.study import Study

RESULTS = ROOT / "results"
RUNS = sorted(path.parent for path in RESULTS.rglob("config.json"))
MOST_BYTES = 8 * 10**6
LARGE = ("paper", "beyond", "tuning")  # studies that take long to plan and to summarise


def sparing(studies: Iterable[str | Path]) -> list[Any]:
    """Return parameters of a test, of which `make test` leaves out the large ones."""
    return [
        pytest.param(x, id=Path(x).stem, marks=[pytest.mark.long] * (Path(x).stem in LARGE))
        for x in studies
    ]


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


@pytest.mark.parametrize("file", sparing(["paper", "ablation", *RESULTS.glob("[!f]*.toml")]))
def test_kept_jobs_are_jobs_of_their_study(file: str | Path) -> None:
    """Nothing that is done would be computed again: digests of settings are as they were."""
    study = Study.load(file)
    manifest = RESULTS / study.spec.name / MANIFEST
    kept = read_json(manifest)["jobs"] if manifest.exists() else []
    assert set(kept) <= set(study.execution(RESULTS).jobs)


@pytest.mark.parametrize("directory", sparing(studies_in(RESULTS)))
def test_summaries_are_what_the_report_writes(directory: Path) -> None:
    comparisons = compare_study(directory).comparisons
    assert comparisons
    for one in comparisons:
        said = (directory / one.name / SUMMARY).read_text(encoding="utf-8")
        assert said == to_page(summary_tables(one))


def test_a_published_curve_stands_beside_its_method_and_not_beside_variants() -> None:
    for study in ("ablation", "tuning"):  # of training; of the rule in new tasks
        comparison, *_ = compare_study(RESULTS / study).comparisons
        beside = {line.label for line in comparison.lines if line.published is not None}
        assert [label for label in beside if label.startswith("MAESN")] == ["MAESN"]


def numbers_in(text: str) -> set[str]:
    """The numbers with a decimal point, as they stand there."""
    return set(re.findall(r"-?\d+\.\d+", text))


def linked_tables(page: Path, text: str) -> str:
    """The pages of results that a text links to."""
    links = re.findall(r"\]\(([^)#]*results/[^)#]*)\)", text)
    return "".join((page.parent / link).read_text(encoding="utf-8") for link in links)


@pytest.mark.parametrize(
    ("name", "sections"),
    [
        ("docs/results.md", ""),
        ("docs/explanation/departures.md", "Against the published curves\n"),
        ("README.md", "What it reaches\n"),
    ],
)
def test_numbers_are_those_of_the_tables_that_their_section_links_to(
    name: str, sections: str
) -> None:
    page, checked = ROOT / name, 0
    for section in prose(page).split("\n## "):
        if section.startswith(sections):
            said = numbers_in(re.sub(r"\]\([^)]*\)", "", section))
            assert said - numbers_in(linked_tables(page, section)) == set()
            checked += len(said)
    assert checked > 10


@pytest.mark.parametrize("directory", RUNS, ids=name_of)
def test_every_run_can_be_opened_and_its_policy_loaded(directory: Path) -> None:
    run = Run.open(directory)
    if directory.name == RUN and not (directory.parent / DONE).exists():
        assert run.latest().iteration > 0  # the study goes on with it
        return
    if run.checkpoints():  # some study still has to evaluate the run
        assert run.latest().iteration == run.settings.iterations
    assert [line["iteration"] for line in run.metrics()] == list(range(1, 21))


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
