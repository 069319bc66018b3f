"""The report page: its numbers, hostile texts, and what it says of what is missing."""

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic_runs import (
    NUM_TASKS,
    NUM_UPDATES,
    adaptation_table,
    exploration,
    learning_curve,
    write_run,
)

from maesn.reporting.page import PAGE, page_of, rounded, write_page
from maesn.reporting.sources import compare_runs
from maesn.reporting.statistics import curve

HOSTILE = "</script><script>alert(1)</script><!--"


def data_of(page: str) -> object:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert found
    return json.loads(found[1])


def run_page(directory: Path) -> dict[str, Any]:
    return page_of(compare_runs([directory]))


def test_the_page_is_one_file_of_what_the_run_recorded(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run")
    document = run_page(run)
    write_page(tmp_path / PAGE, document)
    page = (tmp_path / PAGE).read_text()
    assert (tmp_path / PAGE).stat().st_size < 6e6
    assert data_of(page) == json.loads(json.dumps(document))
    # Nothing is fetched: no source or style of elsewhere.
    own = page.replace(re.search(r"<script>(.*?)</script>", page, re.DOTALL)[1], "")  # plotly
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=\"(?!data:)", own)
    explorer, search = document["plane"]["explorer"], document["plane"]["search"]
    assert np.shape(explorer["paths"]) == (25, 6, 2)
    assert np.shape(explorer["adapted"]) == (NUM_TASKS, 2)
    assert np.shape(search["mean"]) == (2, 4, 5, 5)
    assert search["returns"][0] == [-300.0, -250.5, -200.0]
    assert document["plane"]["goals"] == rounded(exploration().goals)


def test_charts_are_the_numbers_of_the_tables(tmp_path: Path) -> None:
    document = run_page(write_run(tmp_path / "run"))
    (compared,) = document["comparisons"]
    returns, success = compared["charts"]
    line, published = returns["lines"]
    assert (line["label"], published["label"]) == ("MAESN", "MAESN, published")
    assert "run/adaptation/test-sparse.csv" in compared["about"]
    wanted = curve(adaptation_table().mean_return[None])
    assert line["x"] == [50.0 * count for count in range(NUM_UPDATES + 1)]
    for name in ("mean", "low", "high"):
        np.testing.assert_allclose(line[name], getattr(wanted, name), atol=1e-3)
    assert success["lines"][0]["label"] == "MAESN"
    solved, before, after = document["learning"]
    np.testing.assert_allclose(before["lines"][0]["mean"], learning_curve().return_before)
    assert after["lines"][0]["x"][-1] == 30.0
    assert (solved["y"], solved["title"]) == ("success rate", "after the inner update")


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


def test_hostile_names_stay_texts(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", note=HOSTILE)
    document = run_page(run) | {"title": HOSTILE}
    write_page(tmp_path / PAGE, document)
    page = (tmp_path / PAGE).read_text()
    assert "<script>alert" not in page
    found = data_of(page)
    assert found["title"] == HOSTILE
    assert ["settings.note", HOSTILE] in found["provenance"]["rows"]


def test_what_json_cannot_say_is_null() -> None:
    assert rounded([[1.5], [np.nan], [np.inf]]) == [[1.5], [None], [None]]
    assert rounded(None) is None


def test_without_plotly_a_sentence_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "plotly", None)
    assert write_page(tmp_path / PAGE, {}) == []
    assert "plotly is missing. pip install -e '.[page]'." in caplog.text
    assert not (tmp_path / PAGE).exists()
