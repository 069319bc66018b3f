"""The report page: its numbers, hostile texts, and what it says of what is missing."""

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from synthetic_runs import (
    NUM_TASKS,
    NUM_UPDATES,
    adaptation_table,
    exploration,
    write_run,
)

from maesn.reporting.page import PAGE, page_of, rounded, write_page
from maesn.reporting.runs import BELIEF, LATENT_PATHS
from maesn.reporting.sources import compare_runs

SVG = "{http://www.w3.org/2000/svg}"
HOSTILE = "</script><script>alert(1)</script><!--"


@pytest.fixture
def charts_undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty picture for each chart: `test_numbers_come_first` looks at them."""
    monkeypatch.setattr("maesn.reporting.page.rendered", lambda *_: b"<svg></svg>")


def data_of(page: str) -> object:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert found
    return json.loads(found[1])


def run_page(directory: Path) -> dict[str, Any]:
    return page_of(compare_runs([directory]))


@pytest.mark.usefixtures("charts_undrawn")
def test_the_page_is_one_file_of_what_the_run_recorded(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run")
    document = run_page(run)
    write_page(tmp_path, document)
    page = (tmp_path / PAGE).read_text()
    assert (tmp_path / PAGE).stat().st_size < 1e6
    assert data_of(page) == json.loads(json.dumps(document))
    # Nothing is fetched: no source or style of elsewhere.
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=\"(?!data:)", page)
    explorer, search = document["plane"]["explorer"], document["plane"]["search"]
    assert np.shape(explorer["paths"]) == (25, 6, 2)
    assert np.shape(explorer["adapted"]) == (NUM_TASKS, 2)
    assert np.shape(search["mean"]) == (2, 4, 5, 5)
    assert search["returns"][0] == [-300.0, -250.5, -200.0]
    assert document["plane"]["goals"] == rounded(exploration().goals)


def test_numbers_come_first_and_charts_are_pictures(tmp_path: Path) -> None:
    document = run_page(write_run(tmp_path / "run"))
    (headline,), (compared,) = document["headlines"], document["comparisons"]
    rates, returns = (getattr(adaptation_table(), name) for name in ("success_rate", "mean_return"))
    assert headline["number"] == f"{100 * rates[:, -1].mean():.1f} %"
    assert f"after {50 * NUM_UPDATES} episodes" in headline["text"]
    assert f"from {returns[:, 0].mean():.1f} to {returns[:, -1].mean():.1f}" in headline["text"]
    assert "run/adaptation/test-sparse.csv" in compared["about"]
    charts = [*compared["charts"], *document["learning"]]
    assert [chart["about"].partition(" over ")[0] for chart in charts] == [
        "mean sparse return",
        "success rate",
        "tasks that end above τ",
        "after the inner update success rate",
        "before the inner update mean dense return",
        "after the inner update mean dense return",
    ]
    for chart in charts:
        words = {one.text for one in ElementTree.fromstring(chart["svg"]).iter(f"{SVG}text")}
        assert "MAESN" in words
    # The same run gives the same page.
    assert document == run_page(tmp_path / "run")


@pytest.mark.usefixtures("charts_undrawn")
def test_what_is_missing_is_none(tmp_path: Path) -> None:
    nothing = ["metrics", "adaptation", "exploration", "explorer"]
    document = run_page(write_run(tmp_path / "bare", without=nothing))
    assert document["plane"] is None
    assert document["comparisons"] == document["learning"] == []
    latentless = run_page(write_run(tmp_path / "maml", "maml"))["plane"]
    assert latentless["explorer"] is latentless["search"] is None
    unsearched = write_run(tmp_path / "unsearched")
    (unsearched / "figures" / "searches.npz").unlink()
    assert run_page(unsearched)["plane"]["search"] is None


@pytest.mark.usefixtures("charts_undrawn")
def test_latents_and_beliefs_of_different_runs_share_a_page(tmp_path: Path) -> None:
    runs = [write_run(tmp_path / str(seed), seed=seed) for seed in (0, 1)]
    for run, file in zip(runs, (BELIEF, LATENT_PATHS), strict=True):
        (run / file).unlink()
    plane = page_of(compare_runs(runs))["plane"]
    assert plane["explorer"] is not None
    assert plane["belief"] is not None


@pytest.mark.usefixtures("charts_undrawn")
def test_hostile_names_stay_texts(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", note=HOSTILE)
    document = run_page(run) | {"title": HOSTILE}
    write_page(tmp_path, document)
    page = (tmp_path / PAGE).read_text()
    assert "<script>alert" not in page
    found = data_of(page)
    assert found["title"] == HOSTILE
    assert ["settings.note", HOSTILE] in found["provenance"]["rows"]


def test_what_json_cannot_say_is_null() -> None:
    assert rounded([[1.5], [np.nan], [np.inf]]) == [[1.5], [None], [None]]
    assert rounded(None) is None
