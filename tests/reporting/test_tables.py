"""Summaries: the numbers that are printed are the intervals' own."""

import io
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from synthetic_runs import NUM_UPDATES, adaptation_table, line, write_adaptation

from maesn.reporting.comparison import Comparison
from maesn.reporting.figures.curves import adaptation_charts, plot_ends
from maesn.reporting.page import page_of
from maesn.reporting.reading import DEPLOY, MEASURES, AdaptationTable
from maesn.reporting.sources import Compared
from maesn.reporting.statistics import INTERVAL, bootstrap, mean
from maesn.reporting.tables import (
    UNITS,
    TextTable,
    adaptation_tables,
    print_tables,
    summary_tables,
)

TABLE, FRESH = (adaptation_table(num_tasks=30, seed=seed) for seed in range(2))
SCALE = np.array([1, 1, 100, 100, 100])  # of the measures: shares are printed in percent


@pytest.fixture(name="file")
def a_file(tmp_path: Path) -> Path:
    return tmp_path / "test-sparse.csv"


def summarised(
    file: Path, table: AdaptationTable, deployed: AdaptationTable | None = None
) -> list[TextTable]:
    write_adaptation(file, table, deployed)
    return adaptation_tables(file)


def shown(tables: Sequence[TextTable]) -> str:
    with io.StringIO() as output:
        print_tables(tables, Console(file=output, width=80))
        return output.getvalue()


def markdown_cells(table: TextTable) -> list[list[str]]:
    lines = [line for line in table.to_markdown().splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def numbers(cell: str) -> list[float]:
    return [float(text) for text in re.findall(r"[-+]?\d+\.\d", cell)]


def halves(update: int) -> list[list[float]]:
    """Return mean and half the width of the interval of every measure, as printed."""
    found = [bootstrap(mean, getattr(TABLE, name)[None, :, update]) for name in MEASURES]
    pairs = [[one.mean, (one.high - one.low) / 2] for one in found]
    return (SCALE[:, None] * np.array(pairs)).tolist()


def test_markdown_has_every_interval(file: Path) -> None:
    (table,) = summarised(file, TABLE)
    heads, _, *rows = markdown_cells(table)
    assert heads[:2] == ["update", "episodes"]
    assert [row[:2] for row in rows] == [["0", "0"], ["1", "50"], ["2", "100"], ["3", "150"]]
    for update, row in enumerate(rows):
        np.testing.assert_allclose([*map(numbers, row[2:])], halves(update), atol=0.0501)


def test_the_terminal_shows_means_and_half_widths_in_80_columns(file: Path) -> None:
    text = shown(summarised(file, TABLE))
    lines = [line.rstrip() for line in text.splitlines()]
    assert "Adaptation: test-sparse" in lines[0]
    rows = [line for line in lines if re.match(r"\s*\d+\s+\d+\s", line)]
    assert max(map(len, rows)) <= 80
    assert f"± half the {INTERVAL}" in " ".join(text.split())
    assert "Judged on the episodes that were learned from" in text
    assert len(rows) == NUM_UPDATES + 1
    np.testing.assert_allclose(numbers(rows[-1]), np.ravel(halves(-1)), atol=0.0501)
    fresh = shown(summarised(file, TABLE, FRESH))
    assert f"{FRESH.mean_return[:, -1].mean():.1f}" in fresh
    assert "Judged on fresh episodes of the deployed agent." in fresh


def test_the_last_point_is_said_with_its_interval(file: Path) -> None:
    said = summarised(file, TABLE, FRESH)[0].notes[0]
    assert said.startswith("After 150 episodes in each of 30 tasks: reaches goal (%)")
    for name, scale in (("success_rate", 100), ("mean_return", 1)):
        end = bootstrap(mean, scale * getattr(FRESH, name)[None, :, -1])
        assert f"{end.mean:.1f} [{end.low:.1f}, {end.high:.1f}]" in said


def test_tasks_solved_at_reset_are_counted_and_left_out_of_a_second_table(file: Path) -> None:
    at_reset = np.zeros((30, NUM_UPDATES + 1))
    at_reset[[4, 7, 8]] = 1.0
    everything, others = summarised(file, replace(TABLE, solved_at_reset=at_reset))
    counted = "3 of the 30 tasks are solved at reset."
    assert counted in everything.to_markdown()
    assert counted not in others.to_markdown()
    assert others.title == "Adaptation: test-sparse, without tasks solved at reset"
    rest = np.delete(TABLE.mean_return[:, -1], [4, 7, 8])
    assert numbers(others.rows[-1][2])[0] == pytest.approx(np.mean(rest), abs=0.0501)
    (table,) = summarised(file, replace(TABLE, solved_at_reset=np.ones((30, NUM_UPDATES + 1))))
    assert "30 of the 30 tasks are solved at reset." in table.to_markdown()


def test_one_task_has_means_without_intervals(file: Path) -> None:
    table, _ = summarised(file, adaptation_table(num_tasks=1))
    assert not any("±" in cell for row in table.rows for cell in row)


def test_tasks_without_a_success_had_nothing_to_learn_from(file: Path) -> None:
    assert "No episode" not in shown(summarised(file, TABLE))
    rates = adaptation_table(num_tasks=12).success_rate.copy()
    rates[[2, 5]] = 0.0
    rates[7, :-1] = 0.0  # one episode after the last update reached the goal
    table = replace(adaptation_table(num_tasks=12), success_rate=rates)
    said = "No episode reached the goal in 2 of 12 tasks"
    assert said in shown(summarised(file, table))
    # What the deployed agent reaches was not learned from.
    deployed = replace(table, purpose=DEPLOY, success_rate=np.ones_like(rates))
    assert said in shown(summarised(file, table, deployed))
    assert "No episode" not in shown(summarised(file.with_name("test-dense.csv"), table))
    none = replace(table, success_rate=np.zeros_like(rates))
    assert "No episode reached a goal:" in shown(summarised(file, none))


def test_where_success_is_not_defined_there_are_dashes(file: Path) -> None:
    nothing = np.full_like(TABLE.success_rate, np.nan)
    names = ("success_rate", "final_success_rate", "time_in_region", "explored_success_rate")
    unsolvable = replace(TABLE, **dict.fromkeys(names, nothing))
    (table,) = summarised(file, unsolvable)
    for row in table.rows:
        assert row[4:] == ("-", "-", "-")
        assert "±" in row[2]
    said = " ".join(table.notes)
    assert ": return " in said
    assert "reaches goal" not in said
    assert "No episode" not in said
    # A comparison has no table of successes, and its figure no panel of them.
    compared = Comparison((line("maesn", unsolvable),))
    assert [one.title for one in summary_tables(compared)][1:] == [
        "Episodes in the new task, and return"
    ]
    assert [chart.y for chart in adaptation_charts(compared)] == ["mean sparse return"]
    assert len(plot_ends(compared).axes) == 1
    (headline,) = page_of(Compared([compared], (), {"study": "", "versions": {}, "jobs": ()}, ()))[
        "headlines"
    ]
    assert headline["number"] == UNITS["mean_return"].number(TABLE.mean_return[:, -1].mean())
    assert "goal" not in headline["text"]


def test_zero_has_no_minus() -> None:
    assert UNITS["mean_return"].number(-0.04) == "0.0"
    assert UNITS["mean_return"].number(-0.06) == "-0.1"


def test_each_of_few_tasks_has_a_row(file: Path) -> None:
    table = adaptation_table(num_tasks=10)
    _, by_task = summarised(file, table)
    assert by_task.title == "Each task, before and after 3 updates"
    for task in range(10):
        ends = [f"{table.mean_return[task, k]:.1f}" for k in (0, -1)]
        rates = [f"{100 * table.success_rate[task, k]:.1f}" for k in (0, -1)]
        assert by_task.rows[task] == (str(task), *ends, *rates)
