"""The tables of latent search beside other rules."""

import csv
from pathlib import Path

import numpy as np
import pytest
import search_tables as tables
from small_runs import tiny_maesn, tiny_settings

from maesn import api
from maesn.runs.run import Run
from maesn.runtime.search import SearchSettings
from maesn.search import PriorSettings
from maesn.search.stored import read_prior, run_prior


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = Run.create(tmp_path_factory.mktemp("source") / "run", tiny_maesn(), tiny_settings())
    run_prior(run, PriorSettings(draws=4, adapted=False, episodes=2, searches=0))
    return run.directory


def test_rows_are_those_of_adapt(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "enable_compilation_cache", lambda: None)
    short = tables.Line("own_searches:BestOf", 3)
    monkeypatch.setitem(tables.GROUPS, "short", {"search": tables.Line(episodes=3), "best": short})
    out = tmp_path / "rows"
    settings = tables.Settings(
        out, runs=(f"tiny={source}",), lines=("short",), num_tasks=3, tasks="validation"
    )
    tables.main(settings)
    with (out / "tiny-best-0.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    asked = tables.evaluation(Run.open(source), short, "validation", 3, 0, 1)
    outcome = api.adapt(source, asked, out=tmp_path / "table.csv").outcome
    assert [(row["task"], row["episodes"]) for row in rows[:4]] == [("0", str(n)) for n in range(4)]
    last = [row for row in rows if row["episodes"] == "3"]
    deployed = [float(row["deployed"]) for row in last]
    np.testing.assert_allclose(deployed, outcome.deployed.mean_return[:, 3], rtol=1e-4)
    searching = [float(row["searching"]) for row in last]
    np.testing.assert_allclose(searching, outcome.explored.mean_return[:, :3].mean(1), rtol=1e-4)
    reached = (outcome.explored.success_rate[:, :3] > 0).any(axis=1)
    assert [float(row["reached"]) for row in last] == reached.tolist()


def test_differences_are_paired_by_task(tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    names = ("deployed", "success", "drawn", "drawn_success", "searching", "reached")
    values = {}
    for line, tasks, episodes in (("search", 6, 20), ("other", 4, 50)):
        values[line] = generator.normal(size=tasks)
        tables.write_row(
            tmp_path / f"run-{line}-0.csv",
            [
                {"task": task, "episodes": episodes, "at_reset": 0.0}
                | dict.fromkeys(names, float(value))
                for task, value in enumerate(values[line])
            ],
        )
    (row,) = (one for one in tables.summarize(tmp_path) if one["line"] == "other")
    gap = values["search"][:4] - values["other"]
    assert row["behind_search"] == pytest.approx(gap.mean(), abs=1e-4)
    assert row["behind_half"] == pytest.approx(1.96 * gap.std(ddof=1) / 2, rel=1e-3)
    assert row["deployed"] == pytest.approx(values["other"].mean(), abs=1e-4)


def test_the_ceiling_is_selected_and_judged_on_different_episodes() -> None:
    # Latent 0 always returns 1; latent 1 returns 10 and 0 in the two halves.
    returns = np.array([[[1.0, 1.0], [10.0, 0.0]]])
    (row,) = tables.ceiling_rows(returns)
    # Selected on the first half: latent 1, judged 0. On the second: latent 0, judged 1.
    assert row["deployed"] == pytest.approx(0.5)


def test_a_permutation_keeps_what_each_latent_returns(source: Path) -> None:
    settings = SearchSettings()
    (path,) = (source / "priors").iterdir()
    model = settings.model(read_prior(path)[0])
    before, after = model.prior.excess, tables.permuted(model, settings).prior.excess
    np.testing.assert_array_equal(np.sort(before, axis=0), np.sort(after, axis=0))
    assert (before != after).any()
