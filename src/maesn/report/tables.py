"""Summaries of adaptation, with intervals, for the terminal and as Markdown."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from maesn.report.adaptation_table import MEASURES, AdaptationTable, read_adaptation, stack_seeds
from maesn.report.reading import writing
from maesn.report.statistics import Interval, difference_interval, mean_intervals


class Unit(NamedTuple):
    """How one measure is printed."""

    heading: str
    scale: float = 1.0
    digits: int = 1

    def number(self, value: float, sign: str = "") -> str:
        """Return the number as text, 0 without a minus; `sign` as in format specifications."""
        return format(self.scale * value, f"{sign}z.{self.digits}f")


_PERCENT = 100.0
MAX_WIDTH = 120  # columns that a table may take where numbers need them
WITHOUT_SOLVED = "without tasks solved at reset"
UNITS: dict[str, Unit] = {
    "mean_return": Unit("return"),
    "goal_return": Unit("goal return"),
    "success_rate": Unit("reaches goal (%)", _PERCENT),
    "final_success_rate": Unit("ends at goal (%)", _PERCENT),
    "time_in_region": Unit("time at goal (%)", _PERCENT),
}


@dataclass(frozen=True)
class IntervalTable:
    """Rows of intervals, one column per measure."""

    title: str
    headings: tuple[str, ...]
    """Of the leading columns that name a row."""
    names: tuple[tuple[str, ...], ...]
    """What each row is."""
    cells: tuple[tuple[Interval, ...], ...]
    """One interval per row and measure."""
    sign: str = ""
    """`"+"` where a number is a difference."""
    note: str = ""
    """Sentences about tasks and methods; empty if there is nothing to be said."""

    @property
    def labels(self) -> str:
        """What the intervals are and resample."""
        return "; or ".join(dict.fromkeys(cell.label for row in self.cells for cell in row))

    def to_rich(self) -> Table:
        """Return a table for the terminal: the mean and half the width of its interval.

        Fits into 80 columns; `to_markdown` has both ends.
        """
        caption = "\n".join(filter(None, (self.note, f"± half the {self.labels}")))
        table = Table(title=self.title, caption=caption, box=None)
        for heading in self.headings:
            table.add_column(heading, justify="right")
        rows = [self._texts(cells, self._short) for cells in self.cells]
        for measure, column in zip(MEASURES, zip(*rows, strict=True), strict=True):
            # A heading may be broken into lines, a number may not.
            width = max(map(len, column))
            table.add_column(UNITS[measure].heading, justify="right", min_width=width)
        for names, texts in zip(self.names, rows, strict=True):
            table.add_row(*(Text(text) for text in (*names, *texts)))
        return table

    def to_markdown(self) -> str:
        """Return a Markdown table with the mean and both ends of its interval."""
        heads = (*self.headings, *(UNITS[measure].heading for measure in MEASURES))
        lines = [f"**{self.title}**", "", markdown_row(heads), markdown_row(["---:"] * len(heads))]
        for names, cells in zip(self.names, self.cells, strict=True):
            lines.append(markdown_row((*names, *self._texts(cells, self._full))))
        notes = " ".join(filter(None, (f"In brackets: {self.labels}.", self.note)))
        return "\n".join([*lines, "", notes, ""])

    def write_markdown(self, path: Path) -> None:
        """Write the Markdown table to a file; its directory is made if need be."""
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(self.to_markdown(), encoding="utf-8")

    def _texts(self, cells: Sequence[Interval], write: Callable[[Interval, str], str]) -> list[str]:
        return [write(cell, measure) for cell, measure in zip(cells, MEASURES, strict=True)]

    def _short(self, interval: Interval, measure: str) -> str:
        mean = UNITS[measure].number(interval.mean, self.sign)
        if not interval.is_known:
            return mean
        return f"{mean} ±{UNITS[measure].number((interval.high - interval.low) / 2)}"

    def _full(self, interval: Interval, measure: str) -> str:
        mean = UNITS[measure].number(interval.mean, self.sign)
        if not interval.is_known:
            return mean
        ends = (UNITS[measure].number(end, self.sign) for end in (interval.low, interval.high))
        return f"{mean} [{', '.join(ends)}]"


def summary_tables(tables: Sequence[AdaptationTable], title: str) -> list[IntervalTable]:
    """Summarise adaptation to all tasks and, where some are solved at reset, to the others alone.

    Args:
        tables: one per seed of the same method, adapted to the same tasks.
        title: of the tables.
    """
    unsolved = ~_solved_at_reset(tables)
    summaries = [summary_table(tables, title)]
    if unsolved.any() and not unsolved.all():
        others = [table.select(unsolved) for table in tables]
        summaries.append(summary_table(others, f"{title}, {WITHOUT_SOLVED}"))
    return summaries


def _solved_at_reset(tables: Sequence[AdaptationTable]) -> Bool[np.ndarray, " task"]:
    flags = [table.is_solved_at_reset for table in tables]
    return np.any(flags, axis=0) if len({len(flag) for flag in flags}) == 1 else flags[0]


def note_on_solved(solved: Bool[np.ndarray, " task"]) -> str:
    """Say how many tasks need not be solved, because their episodes start in the goal region."""
    count, verb = int(solved.sum()), "is" if solved.sum() == 1 else "are"
    return f"{count} of the {len(solved)} tasks {verb} solved at reset." if count else ""


def _note(tables: Sequence[AdaptationTable]) -> str:
    return " ".join(filter(None, (note_on_solved(_solved_at_reset(tables)), _beyond(tables[0]))))


def _beyond(table: AdaptationTable) -> str:
    """Say from where on a method does what it was never trained for; empty for nowhere."""
    if table.first_beyond is None:
        return ""
    return (
        f"Meta-training has prepared for {table.trial_episodes} episodes: from update "
        f"{table.updates[table.first_beyond]} on it is beyond them."
    )


def summary_table(tables: Sequence[AdaptationTable], title: str) -> IntervalTable:
    """Summarise adaptation, update by update.

    Args:
        tables: one per seed of the same method, adapted to the same tasks.
        title: of the table.
    """
    intervals = [mean_intervals(stack_seeds(tables, measure)) for measure in MEASURES]
    return IntervalTable(
        title,
        ("update", "episodes"),
        tuple(
            (str(update), str(count))
            for update, count in zip(tables[0].updates, tables[0].episodes, strict=True)
        ),
        tuple(zip(*intervals, strict=True)),
        note=_note(tables),
    )


def print_adaptation_summary(path: Path, console: Console | None = None) -> None:
    """Show one file of `maesn adapt` in the terminal.

    Args:
        path: of the table.
        console: where it goes; None for standard output.

    Raises:
        RunError: if the file is missing or broken.
    """
    console = Console() if console is None else console
    for summary in summary_tables([read_adaptation(path)], f"Adaptation: {path.stem}"):
        table = summary.to_rich()
        # A narrow terminal may break lines, but no number is cut off.
        width = Measurement.get(console, console.options.update(max_width=MAX_WIDTH), table).maximum
        console.print(table, width=max(console.width, width), crop=False)


def difference_table(
    reference: Sequence[AdaptationTable],
    others: Mapping[str, Sequence[AdaptationTable]],
    title: str,
    update: int = -1,
) -> IntervalTable:
    """Compare methods with a reference on the same tasks: method minus reference, paired.

    Args:
        reference: one table per seed.
        others: for each method's name, one table per seed.
        title: of the table.
        update: after how many updates; -1 for each method's last.
    """
    cells = tuple(
        tuple(
            difference_interval(
                stack_seeds(tables, measure)[..., update],
                stack_seeds(reference, measure)[..., update],
            )
            for measure in MEASURES
        )
        for tables in others.values()
    )
    names = tuple((name,) for name in others)
    notes = [note_on_solved(_solved_at_reset(reference))]
    notes += [f"{name}: {_beyond(tables[0])}" for name, tables in others.items()]
    note = " ".join(text for text in notes if text and not text.endswith(": "))
    return IntervalTable(title, ("method",), names, cells, sign="+", note=note)


def markdown_row(cells: Sequence[str]) -> str:
    """Return one row of a Markdown table."""
    return f"| {' | '.join(cells)} |"
