"""Summaries: the numbers that are printed are the intervals' own."""

import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from synthetic_runs import NUM_UPDATES, adaptation_table, write_adaptation

from maesn.reporting.reading import DEPLOY, MEASURES, AdaptationTable
from maesn.reporting.statistics import INTERVAL, bootstrap, mean
from maesn.reporting.tables import (
    UNITS,
    TextTable,
    print_adaptation_summary,
    update_tables,
)

TABLE, FRESH = (adaptation_table(num_tasks=30, seed=seed) for seed in range(2))
SCALE = np.array([1, 1, 100, 100, 100])  # of the measures: shares are printed in percent


def summary() -> TextTable:
    (table,) = update_tables(TABLE, "MAESN on 30 tasks")
    return table


def shown(table: TextTable, width: int = 80) -> str:
    console = Console(file=io.StringIO(), width=width)
    console.print(table.to_rich())
    output = console.file
    assert isinstance(output, io.StringIO)
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


def test_markdown_has_every_interval() -> None:
    heads, _, *rows = markdown_cells(summary())
    assert heads[:2] == ["update", "episodes"]
    assert [row[:2] for row in rows] == [["0", "0"], ["1", "50"], ["2", "100"], ["3", "150"]]
    for update, row in enumerate(rows):
        np.testing.assert_allclose([*map(numbers, row[2:])], halves(update), atol=0.0501)


def test_the_terminal_shows_means_and_half_widths_in_80_columns() -> None:
    lines = shown(summary()).splitlines()
    assert "MAESN on 30 tasks" in lines[0]
    assert max(map(len, lines)) <= 80
    assert f"± half the {INTERVAL}" in lines[-2]
    assert "Judged on the episodes that were learned from" in lines[-1]
    rows = [line for line in lines if re.match(r"\s*\d+\s+\d+\s", line)]
    assert len(rows) == NUM_UPDATES + 1
    np.testing.assert_allclose(numbers(rows[-1]), np.ravel(halves(-1)), atol=0.0501)


def test_tasks_solved_at_reset_are_counted_and_left_out_of_a_second_table() -> None:
    at_reset = np.zeros((30, NUM_UPDATES + 1))
    at_reset[[4, 7, 8]] = 1.0
    everything, others = update_tables(replace(TABLE, solved_at_reset=at_reset), "MAESN")
    counted = "3 of the 30 tasks are solved at reset."
    assert counted in everything.to_markdown()
    assert counted in shown(everything)
    assert others.title == "MAESN, without tasks solved at reset"
    assert counted not in others.to_markdown()
    rest = np.delete(TABLE.mean_return[:, -1], [4, 7, 8])
    assert numbers(others.rows[-1][2])[0] == pytest.approx(np.mean(rest), abs=0.0501)


def test_where_no_task_is_solved_at_reset_there_is_one_table() -> None:
    assert "solved at reset" not in summary().to_markdown()
    all_solved = replace(TABLE, solved_at_reset=np.ones((30, NUM_UPDATES + 1)))
    (table,) = update_tables(all_solved, "MAESN")
    assert "30 of the 30 tasks are solved at reset." in table.to_markdown()


def test_one_task_has_means_without_intervals() -> None:
    (table,) = update_tables(adaptation_table(num_tasks=1), "one")
    assert not any("±" in cell for row in table.rows for cell in row)


def printed(path: Path, table: AdaptationTable, deployed: AdaptationTable | None = None) -> str:
    write_adaptation(path / "test-sparse.csv", table, deployed)
    console = Console(file=io.StringIO(), width=80)
    print_adaptation_summary(path / "test-sparse.csv", console)
    output = console.file
    assert isinstance(output, io.StringIO)
    return " ".join(output.getvalue().split())


def test_the_summary_of_a_file_is_printed(tmp_path: Path) -> None:
    output = printed(tmp_path, TABLE)
    assert "Adaptation: test-sparse" in output
    assert f"{TABLE.mean_return[:, -1].mean():.1f}" in output
    assert "No episode" not in output
    fresh = printed(tmp_path, TABLE, FRESH)
    assert f"{FRESH.mean_return[:, -1].mean():.1f}" in fresh
    assert "Judged on fresh episodes of the deployed agent." in fresh


def test_tasks_without_a_success_had_nothing_to_learn_from(tmp_path: Path) -> None:
    rates = adaptation_table(num_tasks=12).success_rate.copy()
    rates[[2, 5]] = 0.0
    rates[7, :-1] = 0.0  # one episode after the last update reached the goal
    table = replace(adaptation_table(num_tasks=12), success_rate=rates)
    said = "No episode reached the goal in 2 of 12 tasks: there the adaptation had nothing to learn"
    assert said in printed(tmp_path, table)
    # What the deployed agent reaches was not learned from.
    deployed = replace(table, purpose=DEPLOY, success_rate=np.ones_like(rates))
    assert said in printed(tmp_path, table, deployed)
    write_adaptation(tmp_path / "test-dense.csv", table)
    console = Console(file=io.StringIO())
    print_adaptation_summary(tmp_path / "test-dense.csv", console)
    assert isinstance(console.file, io.StringIO)
    assert "No episode" not in console.file.getvalue()


def test_zero_has_no_minus() -> None:
    assert UNITS["mean_return"].number(-0.04) == "0.0"
    assert UNITS["mean_return"].number(-0.06) == "-0.1"


def test_each_of_few_tasks_has_a_row(tmp_path: Path) -> None:
    table = adaptation_table(num_tasks=10)
    output = printed(tmp_path, table)
    assert "Each task, before and after 3 updates" in output
    for task in range(10):
        ends = [f"{table.mean_return[task, k]:.1f}" for k in (0, -1)]
        rates = [f"{100 * table.success_rate[task, k]:.1f}" for k in (0, -1)]
        assert " ".join([str(task), *ends, *rates]) in output
