"""The report page in Chromium: `make test-browser`.

Chromium comes from the system's packages (`apt install chromium`), or CHROMIUM names it.
`make test-browser PICTURES=docs/figures` makes the pictures of the documentation anew.
"""

import os
import shutil
from pathlib import Path

import pytest
from chromium import DESK, PHONE, Opened
from playwright.sync_api import Browser
from synthetic_runs import write_run

from maesn import GradientRule, SearchRule, adapt
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.exploration import record_exploration, record_explorer
from maesn.reporting.page import PAGE, page_of, write_page
from maesn.reporting.runs import EXPLORATION
from maesn.reporting.sources import compare_runs, compare_study
from maesn.runs.run import Run
from maesn.studies.spec import EvaluationSpec, ScratchSpec, StudySpec
from maesn.studies.study import Study

HOSTILE = "<img src=x onerror=window.hacked=1>"
PICTURES = (("light", DESK, "light"), ("dark", DESK, "dark"), ("phone", PHONE, "light"))


@pytest.fixture(scope="module")
def of_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    document = page_of(compare_runs([write_run(folder / "run", note=HOSTILE)]))
    write_page(folder, document | {"title": f"MAESN {HOSTILE}"})
    return folder / PAGE


@pytest.fixture(scope="module")
def of_study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    few = Evaluation(num_tasks=4, episodes=6, episodes_per_update=3)
    spec = StudySpec(
        "small",
        ("point",),
        scratch={"trpo": ScratchSpec(label=HOSTILE), "reinforce": ScratchSpec()},
        evaluations={"few": EvaluationSpec(few)},
    )
    Study(spec).run(folder, workers=1)
    write_page(folder, page_of(compare_study(folder / "small")))
    return folder / PAGE


@pytest.mark.parametrize("width", [PHONE, DESK])
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", ["of_run", "of_study"])
def test_the_page_opens_without_errors_and_fits(
    browser: Browser, request: pytest.FixtureRequest, name: str, scheme: str, width: int
) -> None:
    opened = Opened(browser, request.getfixturevalue(name), width, scheme)
    opened.page.wait_for_selector(".chart")
    widths = "[...document.querySelectorAll('img.chart')].map((one) => one.naturalWidth)"
    assert min(opened.page.evaluate(widths)) > 0  # every chart is an image that can be read
    assert opened.said == []
    assert opened.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert opened.page.evaluate("document.documentElement.dataset.theme") == scheme
    assert opened.page.evaluate("window.hacked") is None


def test_the_point_is_moved_by_pointer_keys_and_tasks(browser: Browser, of_run: Path) -> None:
    opened = Opened(browser, of_run)
    page, handle = opened.page, opened.page.locator("#handle")
    assert "z = (0.0, 0.0) leads to (0.0 m, 0.0 m)" in opened.text("#explorer-said")
    plane = page.locator(".plane .frame").first.bounding_box()
    assert plane is not None
    # From the middle to the middle of the upper right quarter: the latent leads where it points.
    page.mouse.move(plane["x"] + plane["width"] / 2, plane["y"] + plane["height"] / 2)
    page.mouse.down()
    page.mouse.move(plane["x"] + 0.75 * plane["width"], plane["y"] + 0.25 * plane["height"])
    page.mouse.up()
    assert "leads to (1.5 m, 1.5 m)" in opened.text("#explorer-said")
    handle.focus()
    for _ in range(20):
        page.keyboard.press("ArrowLeft")
    assert "leads to (−1.5 m, 1.5 m)" in opened.text("#explorer-said")
    page.select_option("#explorer-task", "2")
    assert "from the goal of task 2" in opened.text("#explorer-said")
    assert page.locator(".ring.now").count() == 1
    assert page.locator(".region").count() >= 1
    page.keyboard.press("Tab")
    assert opened.said == []


def test_a_search_is_watched(browser: Browser, of_run: Path) -> None:
    opened = Opened(browser, of_run)
    page = opened.page
    # It opens with the first episode that reaches the goal.
    assert opened.text("#search-said").startswith("Episode 2 returns −250.5 and reaches the goal.")
    assert page.locator(".played").count() == page.locator(".number").count() == 2
    cell = page.locator("#search-plane rect[fill]").first
    before = cell.get_attribute("fill")
    page.select_option("#search-kind", "std")
    assert cell.get_attribute("fill") != before
    page.locator("#search-slider").focus()
    page.keyboard.press("Home")
    assert page.locator(".number").count() == 0
    said = opened.text("#search-said")
    assert said.startswith("Before any episode. ")
    assert " Next it tries z = (" in said
    page.select_option("#search-task", "1")
    page.click("#search-play")
    page.wait_for_function(
        "document.getElementById('search-said').textContent.startsWith('Episode 3')", timeout=9000
    )
    assert "does not reach the goal." in opened.text("#search-said")
    assert opened.text("#search-play") == "Play"


def test_a_belief_is_watched(browser: Browser, of_run: Path) -> None:
    opened = Opened(browser, of_run)
    assert opened.text("#belief-said").startswith("Step 3 of episode 2: the belief predicts 0.00 ")
    opened.page.locator("#belief-slider").focus()
    opened.page.keyboard.press("Home")
    said = "Before any step: the belief predicts 0.50 to 0.50, and its spread is 1.00."
    assert opened.text("#belief-said") == said
    assert opened.said == []


def test_tables_sort_and_lines_are_compared(browser: Browser, of_study: Path) -> None:
    opened = Opened(browser, of_study)
    page = opened.page
    first = page.locator("table").first

    def column(number: int) -> list[str]:
        return first.locator(f"tbody tr td:nth-child({number})").all_inner_texts()

    names = first.locator("thead th").all_inner_texts()
    returns = names.index("return") + 1
    first.locator("thead button").nth(returns - 1).click()
    ascending = [float(text.split()[0]) for text in column(returns)]
    assert ascending == sorted(ascending)
    first.locator("thead button").nth(returns - 1).click()
    assert [float(text.split()[0]) for text in column(returns)] == ascending[::-1]
    assert HOSTILE in " ".join(column(1))
    page.locator("details").nth(0).locator("summary").click()
    page.select_option(".scatter-up", "2")
    settings = page.locator("details").nth(1)
    settings.locator("summary").click()
    assert "evaluation.episodes" in settings.inner_text()
    assert page.evaluate("window.hacked") is None
    assert opened.said == []


def test_pictures_of_a_shipped_policy(browser: Browser, tmp_path: Path) -> None:
    run = tmp_path / "wheeled"
    shutil.copytree(Run.open("wheeled").directory, run)
    for rule in (GradientRule(), SearchRule()):
        adapt(run, rule=rule)
    record_exploration(Run.open(run), run / EXPLORATION)
    record_explorer(Run.open(run))
    write_page(tmp_path, page_of(compare_runs([run])))
    assert (tmp_path / PAGE).stat().st_size < 1.5e6
    out = Path(os.environ.get("PICTURES") or tmp_path)
    for name, width, scheme in PICTURES:
        opened = Opened(browser, tmp_path / PAGE, width, scheme)
        opened.page.select_option("#explorer-task", "7")
        opened.page.locator("#search-slider").fill("4")
        assert "Episode 4" in opened.text("#search-said")
        opened.page.screenshot(path=out / f"page-{name}.png")
        assert opened.said == []
