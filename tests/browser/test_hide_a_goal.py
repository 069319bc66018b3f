"""The page "Hide a goal" in Chromium: its arithmetic is that of the library, and it can be used."""

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from chromium import DESK, PHONE, Opened
from playwright.sync_api import Browser
from scripts import ROOT, load_script

PAGE = ROOT / "docs/site/hide_a_goal.html"
# Robot, scene, goal in metres, track. The last of `wheeled` and `ant` lie where none was trained.
TEN = [
    *((0, 0, goal, 0) for goal in ([1.2, 1.6], [-1.6, 1.2], [0.0, 2.0], [-0.9, -0.9])),
    *(
        (1, scene, [0.85, y], track)
        for scene, y, track in ((0, -0.16, 4), (1, -0.4, 1), (2, 0.1, 5))
    ),
    *((2, 0, goal, 0) for goal in ([2.0, 0.0], [-1.2, 1.6], [1.6, 2.1])),
]


@pytest.fixture(scope="module")
def games() -> ModuleType:
    return load_script("docs/hide_a_goal/games.py")


@pytest.fixture(scope="module")
def robots(games: ModuleType) -> list[object]:
    return list(games.read_page(PAGE))


@pytest.fixture
def opened(browser: Browser) -> Opened:
    opened = Opened(browser, PAGE)
    opened.page.wait_for_selector("body[data-ready]")
    return opened


def test_the_search_is_that_of_the_library(
    opened: Opened, games: ModuleType, robots: list[object]
) -> None:
    for robot, scene, goal, track in TEN:
        theirs = opened.page.evaluate(
            """async ([index, scene, goal, track]) => {
              const robot = data.robots[index];
              await choose(robot);
              return transcript(robot, scene, goal, track);
            }""",
            [robot, scene, goal, track],
        )
        ours = games.transcript(robots[robot], scene, np.array(goal), track)
        assert [row["point"] for row in theirs] == [row["point"] for row in ours]
        assert [row["reached"] is not None for row in theirs] == [row["reached"] for row in ours]
        for name in ("return", "mean", "std", "familiar"):
            found, expected = ([row[name] for row in rows] for rows in (theirs, ours))
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    assert opened.said == []


@pytest.mark.parametrize("width", [PHONE, DESK])
def test_a_visitor_hides_a_goal(browser: Browser, width: int) -> None:
    opened = Opened(browser, PAGE, width)
    page = opened.page
    page.wait_for_selector("body[data-ready]")
    floor = page.locator("#search svg")
    box = floor.bounding_box()
    assert box is not None
    # A quarter from the left, at half the height: the goal snaps to the half circle.
    floor.click(position={"x": box["width"] / 4, "y": box["height"] / 2})
    x, y = page.evaluate("now.goal")
    assert np.hypot(x, y) == pytest.approx(2.0)
    assert x < 0 < y
    page.locator("#anywhere").check()
    assert page.evaluate("hide([0, -1.5]), now.goal") == pytest.approx([0, -1.5])
    floor.press("ArrowRight")
    assert page.evaluate("now.goal[0]") == pytest.approx(0.2)
    page.get_by_role("tab", name="Block pushing").click()
    page.get_by_role("button", name="Layout 2").click()
    x, y = page.evaluate(
        """() => {
          const point = new DOMPoint(...lanes[0].to(lanes[0].blocks[2]));
          const { x, y } = point.matrixTransform(lanes[0].svg.getScreenCTM());
          return [x, y];
        }"""
    )
    page.mouse.click(x, y)
    track, block, goal = page.evaluate("[now.track, startOf(3), now.goal]")
    assert track == 3
    assert goal == pytest.approx([0.75, block[1]])
    page.get_by_role("tab", name="Ant").click()
    page.wait_for_selector("#search .pips .reached", timeout=10_000)
    assert "Found in attempt" in opened.text("#said")
    assert "Of 100 goals, search finds" in opened.text("#shares")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert opened.said == []


def test_it_is_small_and_asks_no_network() -> None:
    text = Path(PAGE).read_text("utf-8")
    assert len(text) < 1.5e6
    assert "http" not in text.replace("http://www.w3.org/2000/svg", "")
