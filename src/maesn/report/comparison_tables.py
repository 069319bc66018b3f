"""What a comparison comes to, as tables: where the methods end, and who beats whom."""

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from maesn.report.comparison import Comparison, Line, paired
from maesn.report.reading import writing
from maesn.report.statistics import (
    Interval,
    improvement_interval,
    interquartile_mean_interval,
    mean_interval,
    score_interval,
)
from maesn.report.tables import MAX_WIDTH, UNITS, WITHOUT_SOLVED, Unit, markdown_row, note_on_solved

_SCORE = Unit("score", digits=2)
_SCORE_INTERVAL = (
    "The score's interval draws the same tasks for method, floor and oracle; there is none if in "
    "some of the draws the oracle is not above the floor."
)
_MILLION = 1e6
_PROBABILITY = Unit("probability", digits=2)


@dataclass(frozen=True)
class TextTable:
    """A table of texts, with a title above and sentences below."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def to_rich(self) -> Table:
        """Return the table for a terminal."""
        table = Table(title=self.title, caption="\n".join(self.notes), box=None)
        for column, heading in enumerate(self.headings):
            # A heading may be broken between words, a number may not be broken.
            widths = [len(row[column]) for row in self.rows] + [*map(len, heading.split())]
            table.add_column(heading, justify="right" if column else "left", min_width=max(widths))
        for row in self.rows:
            table.add_row(*map(Text, row))
        return table

    def to_markdown(self) -> str:
        """Return the table as Markdown."""
        ruler = ["---", *["---:"] * (len(self.headings) - 1)]
        lines = [markdown_row(row) for row in (self.headings, ruler, *self.rows)]
        return "\n".join([f"**{self.title}**", "", *lines, "", *self.notes, ""])


def summary_tables(comparison: Comparison) -> list[TextTable]:
    """Return where each method ends and, if there are several, who beats whom.

    Where some methods were adapted to the first tasks alone, it is said where all end in these;
    where some tasks are solved at reset, where the methods end in the others.
    """
    tables = [_ends(comparison)]
    fewest = min(line.num_tasks for line in comparison.lines)
    if fewest < max(line.num_tasks for line in comparison.everyone):
        tables.append(_ends(comparison.of_first(fewest), f"the first {fewest} alone"))
    unsolved = ~comparison.is_solved_at_reset
    others = comparison.of_tasks(unsolved)
    if others.lines and not unsolved.all():
        tables.append(_ends(others, WITHOUT_SOLVED))
    if len(comparison.lines) > 1:
        tables.append(_improvements(comparison))
    return tables


def write_summary(comparison: Comparison, path: Path) -> None:
    """Write the tables as Markdown.

    Raises:
        RunError: the file cannot be written.
    """
    texts = [table.to_markdown() for table in summary_tables(comparison)]
    with writing(path):
        path.write_text("\n".join(texts), encoding="utf-8")


def print_summary(comparison: Comparison, console: Console | None = None) -> None:
    """Show the tables in the terminal.

    Args:
        comparison: what to show.
        console: where; None for standard output.
    """
    console = Console() if console is None else console
    for table in summary_tables(comparison):
        # A narrow terminal may break lines, but no number is cut off.
        console.print(table.to_rich(), width=max(console.width, MAX_WIDTH), crop=False)


def _ends(comparison: Comparison, addition: str = "") -> TextTable:
    headings = (
        "method",
        "trained on",
        "seeds",
        "tasks",
        "updates",
        "steps",
        "return",
        "IQM",
        "reaches goal (%)",
        "score",
    )
    labels: list[str] = []
    rows = [_end(comparison, line, labels) for line in comparison.everyone]
    notes = [
        "Mean and interquartile mean (IQM) of the sparse-reward curves' last points."
        if comparison.lines[0].tables[0].reward == "sparse"
        else "Mean and interquartile mean (IQM) of the dense-reward curves' last points.",
        f"In brackets: {'; or '.join(dict.fromkeys(labels))}.",
        "Trained on: environment steps of meta-training." if _is_trained(comparison) else "",
        note_on_solved(comparison.is_solved_at_reset),
        *(_beyond(line) for line in comparison.lines if line.first_beyond is not None),
        comparison.why_no_score or _SCORE_INTERVAL,
        "" if comparison.why_no_score else _scoreless(comparison),
    ]
    tasks = ", ".join(filter(None, (f"{comparison.lines[0].tables[0].tasks} tasks", addition)))
    title = f"After each method's last update, in {tasks}"
    return TextTable(title, headings, tuple(rows), tuple(filter(None, notes)))


def _is_trained(comparison: Comparison) -> bool:
    return any(line.training_steps is not None for line in comparison.everyone)


def _end(comparison: Comparison, line: Line, labels: list[str]) -> tuple[str, ...]:
    """Return one method's row; what its intervals resample is added to the labels."""
    last = line.measure("mean_return")[..., -1]
    returns, middle = mean_interval(last), interquartile_mean_interval(last)
    success = mean_interval(line.measure("success_rate")[..., -1])
    labels += [returns.label, middle.label]
    return (
        line.label,
        "" if line.training_steps is None else f"{line.training_steps / _MILLION:.3g} M",
        str(len(line.seeds)),
        str(line.num_tasks),
        str(int(line.tables[0].updates[-1])),
        f"{int(comparison.steps(line)[-1]):,}",
        _text(returns, UNITS["mean_return"]),
        _text(middle, UNITS["mean_return"]),
        _text(success, UNITS["success_rate"]),
        _score(comparison, line),
    )


def _score(comparison: Comparison, line: Line) -> str:
    """Return the score of the last point with its interval; empty if there is no score."""
    if comparison.oracle is None or comparison.score(np.zeros(1), line.num_tasks) is None:
        return ""
    oracle, *baselines = (
        one.measure("mean_return")[:, : line.num_tasks, 0]
        for one in (comparison.oracle, *comparison.floor)
    )
    last = line.measure("mean_return")[..., -1]
    return _text(score_interval(last, baselines, oracle), _SCORE)


def _scoreless(comparison: Comparison) -> str:
    """Name the methods that have no score where others have one; empty if there are none."""
    lines = comparison.lines
    labels = [line.label for line in lines if comparison.score(np.zeros(1), line.num_tasks) is None]
    if not labels:
        return ""
    return f"No score of {', '.join(labels)}: on these tasks the oracle is not above the floor."


def _beyond(line: Line) -> str:
    """Say where a method ends within what it was trained for."""
    assert line.first_beyond is not None
    last = line.first_beyond - 1
    prepared = mean_interval(line.measure("mean_return")[..., last])
    return (
        f"{line.label} was trained for trials of {line.trial_episodes} episodes, and is beyond "
        f"them from update {last + 1} on: after update {last}, the last that it was trained for, "
        f"its return is {_text(prepared, UNITS['mean_return'])}."
    )


def _improvements(comparison: Comparison) -> TextTable:
    rows, labels = [], []
    for first, second in combinations(comparison.lines, 2):
        interval = improvement_interval(*paired(first, second, "mean_return"))
        labels.append(interval.label)
        rows.append((first.label, second.label, _text(interval, _PROBABILITY)))
    return TextTable(
        "Probability that the first method's last point is above the second's in a task",
        ("first", "second", "probability"),
        tuple(rows),
        (
            f"In brackets: {'; or '.join(dict.fromkeys(labels))}. A tie counts as half a win.",
            *(
                f"{line.label}: after update {int(line.tables[0].updates[-1])}, beyond its trials."
                for line in comparison.lines
                if line.first_beyond is not None
            ),
        ),
    )


def _text(interval: Interval, unit: Unit) -> str:
    mean = unit.number(interval.mean)
    if not interval.is_known:
        return mean
    return f"{mean} [{unit.number(interval.low)}, {unit.number(interval.high)}]"
