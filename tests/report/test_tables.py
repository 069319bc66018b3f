"""Summaries: the numbers that are printed are the intervals' own."""

import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from synthetic_runs import NUM_UPDATES, adaptation_table, write_adaptation

from maesn.report import print_adaptation_summary
from maesn.report.adaptation_table import MEASURES
from maesn.report.statistics import difference_interval, mean_interval
from maesn.report.tables import (
    UNITS,
    IntervalTable,
    difference_table,
    summary_table,
    summary_tables,
)

TABLES = [adaptation_table(num_tasks=30, seed=seed) for seed in range(3)]
PERCENT = {"success_rate", "final_success_rate", "time_in_region"}


def shown(table: IntervalTable, width: int = 80) -> str:
    console = Console(file=io.StringIO(), width=width)
    console.print(table.to_rich())
    output = console.file
    assert isinstance(output, io.StringIO)
    return output.getvalue()


def markdown_cells(table: IntervalTable) -> list[list[str]]:
    lines = [line for line in table.to_markdown().splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def numbers(cell: str) -> list[float]:
    return [float(text) for text in re.findall(r"[-+]?\d+\.\d", cell)]


def test_markdown_has_every_interval() -> None:
    heads, _, *rows = markdown_cells(summary_table(TABLES, "MAESN"))
    assert heads[:2] == ["update", "episodes"]
    assert [row[:2] for row in rows] == [["0", "0"], ["1", "50"], ["2", "100"], ["3", "150"]]
    for update, row in enumerate(rows):
        for name, cell in zip(MEASURES, row[2:], strict=True):
            values = np.stack([table.measure(name)[:, update] for table in TABLES])
            interval = mean_interval(values)
            scale = 100.0 if name in PERCENT else 1.0
            expected = scale * np.array([interval.mean, interval.low, interval.high])
            np.testing.assert_allclose(numbers(cell), expected, atol=0.0501)


def test_markdown_says_what_the_brackets_are() -> None:
    text = summary_table(TABLES, "MAESN").to_markdown()
    assert "In brackets: 95 % interval, resampling 30 tasks and 3 seeds." in text
    assert "**MAESN**" in text


def test_differences_are_method_minus_reference() -> None:
    worse = [adaptation_table(num_tasks=30, seed=7, gain=10.0)]
    table = difference_table(TABLES, {"MAML": worse}, "Minus MAESN")
    (row,) = table.cells
    first, second = (
        worse[0].mean_return[None, :, -1],
        np.stack([t.mean_return[:, -1] for t in TABLES]),
    )
    assert row[0] == difference_interval(first, second)
    assert row[0].mean < -30.0
    assert markdown_cells(table)[2][0] == "MAML"
    assert markdown_cells(table)[2][1].startswith("-3")
    assert "+" in difference_table(worse, {"MAESN": TABLES}, "").to_markdown()


def test_the_terminal_shows_means_and_half_widths_in_80_columns() -> None:
    table = summary_table(TABLES, "MAESN on 30 tasks")
    lines = shown(table).splitlines()
    assert "MAESN on 30 tasks" in lines[0]
    assert max(map(len, lines)) <= 80
    assert "± half the 95 % interval, resampling 30 tasks and 3 seeds" in lines[-1]
    rows = [line for line in lines if re.match(r"\s*\d+\s+\d+\s", line)]
    assert len(rows) == NUM_UPDATES + 1
    last = [cell.mean for cell in table.cells[-1]]
    printed = numbers(rows[-1])[::2]
    np.testing.assert_allclose(printed, np.array(last) * [1, 1, 100, 100, 100], atol=0.0501)


def test_tasks_solved_at_reset_are_counted_and_left_out_of_a_second_table() -> None:
    at_reset = np.zeros((30, NUM_UPDATES + 1))
    at_reset[[4, 7, 8]] = 1.0
    tables = [replace(table, solved_at_reset=at_reset) for table in TABLES]
    everything, others = summary_tables(tables, "MAESN")
    assert everything.note == "3 of the 30 tasks are solved at reset."
    assert everything.note in everything.to_markdown()
    assert everything.note in shown(everything)
    assert (others.title, others.note) == ("MAESN, without tasks solved at reset", "")
    rest = [np.delete(table.mean_return[:, -1], [4, 7, 8]) for table in TABLES]
    assert others.cells[-1][0] == mean_interval(np.stack(rest))
    assert difference_table(tables, {"MAML": TABLES}, "").note == everything.note


def test_where_no_task_is_solved_at_reset_there_is_one_table_without_a_note() -> None:
    (summary,) = summary_tables(TABLES, "MAESN")
    assert summary.note == ""
    all_solved = replace(TABLES[0], solved_at_reset=np.ones((30, NUM_UPDATES + 1)))
    (summary,) = summary_tables([all_solved], "MAESN")
    assert summary.note == "30 of the 30 tasks are solved at reset."


def test_one_task_has_means_without_intervals() -> None:
    table = summary_table([adaptation_table(num_tasks=1)], "one")
    assert "±" not in "".join(shown(table).splitlines()[:-1])
    assert "[" not in table.to_markdown()
    assert "no interval: 1 task and 1 seed" in table.to_markdown()


def test_markdown_is_written(tmp_path: Path) -> None:
    table = summary_table(TABLES, "MAESN")
    table.write_markdown(tmp_path / "results" / "maesn.md")
    assert (tmp_path / "results" / "maesn.md").read_text(encoding="utf-8") == table.to_markdown()


def test_the_summary_of_a_file_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_adaptation(tmp_path / "test-sparse.csv", TABLES[0])
    print_adaptation_summary(tmp_path / "test-sparse.csv")
    output = capsys.readouterr().out
    assert "Adaptation: test-sparse" in output
    assert f"{TABLES[0].mean_return[:, -1].mean():.1f}" in output


def test_zero_has_no_minus() -> None:
    assert UNITS["mean_return"].number(-0.04) == "0.0"
    assert UNITS["mean_return"].number(-0.04, sign="+") == "+0.0"
    assert UNITS["mean_return"].number(-0.06) == "-0.1"
