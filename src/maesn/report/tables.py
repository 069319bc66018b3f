"""Tables of numbers with their intervals, for the terminal and as Markdown."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool
from rich.console import Console
from rich.table import Table
from rich.text import Text

from maesn.report.adaptation_table import (
    JUDGED,
    MEASURES,
    AdaptationTable,
    solved_at_reset,
    stack_seeds,
)
from maesn.report.reading import read_adaptation
from maesn.report.statistics import Interval, bootstrap, difference, mean_intervals
from maesn.storage import write_whole

_MAX_WIDTH = 120  # columns that a table may take where numbers need them
_FEW_TASKS = 10  # each has a row of its own
WITHOUT_SOLVED = "without tasks solved at reset"


class Unit(NamedTuple):
    """How one measure is printed."""

    heading: str
    scale: float = 1.0
    digits: int = 1

    def number(self, value: float, sign: str = "") -> str:
        """Return the number as text, 0 without a minus; `sign` as in format specifications."""
        return format(self.scale * value, f"{sign}z.{self.digits}f")

    def ends(self, interval: Interval, sign: str = "") -> str:
        """Return the mean and both ends of its interval, where it has any."""
        numbers = interval.mean, interval.low, interval.high
        mean, low, high = (self.number(x, sign) for x in numbers)
        return f"{mean} [{low}, {high}]" if interval.is_known else mean

    def half_width(self, interval: Interval) -> str:
        """Return the mean and half the width of its interval, which is shorter."""
        mean, half = (self.number(x) for x in (interval.mean, (interval.high - interval.low) / 2))
        return f"{mean} ±{half}" if interval.is_known else mean


_PERCENT = 100.0
UNITS: dict[str, Unit] = {
    "mean_return": Unit("return"),
    "goal_return": Unit("goal return"),
    "success_rate": Unit("reaches goal (%)", _PERCENT),
    "final_success_rate": Unit("ends at goal (%)", _PERCENT),
    "time_in_region": Unit("time at goal (%)", _PERCENT),
}
_HEADINGS = tuple(unit.heading for unit in UNITS.values())


@dataclass(frozen=True)
class TextTable:
    """A table of texts, with a title above and sentences below."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    is_named: bool = False
    """Whether the first column holds names, which stand at the left."""

    def to_rich(self) -> Table:
        """Return the table for a terminal."""
        table = Table(title=self.title, caption="\n".join(self.notes), box=None)
        for column, heading in enumerate(self.headings):
            # A heading may be broken between words, a number may not be broken.
            widths = [len(row[column]) for row in self.rows] + [*map(len, heading.split())]
            left = self.is_named and not column
            table.add_column(heading, justify="left" if left else "right", min_width=max(widths))
        for row in self.rows:
            table.add_row(*map(Text, row))
        return table

    def to_markdown(self) -> str:
        """Return the table as Markdown."""
        ruler = ["---" if self.is_named else "---:", *["---:"] * (len(self.headings) - 1)]
        lines = [markdown_row(row) for row in (self.headings, ruler, *self.rows)]
        return "\n".join([f"**{self.title}**", "", *lines, "", *self.notes, ""])


def markdown_row(cells: Sequence[str]) -> str:
    """Return one row of a Markdown table."""
    return f"| {' | '.join(cells)} |"


def print_tables(tables: Sequence[TextTable], console: Console | None = None) -> None:
    """Show tables in the terminal. A narrow one may break lines, but no number is cut off."""
    console = console or Console()
    for table in tables:
        console.print(table.to_rich(), width=max(console.width, _MAX_WIDTH), crop=False)


def write_tables(tables: Sequence[TextTable], path: Path) -> None:
    """Write tables as Markdown."""
    write_whole(path, "\n".join(table.to_markdown() for table in tables).encode())


def summary_tables(
    tables: Sequence[AdaptationTable], title: str, *, brief: bool = False
) -> list[TextTable]:
    """Summarise adaptation to all tasks and, where some are solved at reset, to the others alone.

    There is one table per seed of the same method, adapted to the same tasks. Summaries that are
    `brief` have half the widths of the intervals instead of their ends, to fit into 80 columns.
    """
    summaries = [_summary_table(tables, title, brief=brief)]
    unsolved = ~solved_at_reset(tables)
    if unsolved.any() and not unsolved.all():
        others = [table.part(unsolved) for table in tables]
        summaries.append(_summary_table(others, f"{title}, {WITHOUT_SOLVED}", brief=brief))
    return summaries


def _summary_table(tables: Sequence[AdaptationTable], title: str, *, brief: bool) -> TextTable:
    """Summarise adaptation, update by update."""
    intervals = {name: mean_intervals(stack_seeds(tables, name)) for name in MEASURES}
    texts = [
        [UNITS[name].half_width(one) if brief else UNITS[name].ends(one) for one in column]
        for name, column in intervals.items()
    ]
    labels = labels_of(one for column in intervals.values() for one in column)
    first = tables[0]
    note = _join(note_on_solved(solved_at_reset(tables)), _beyond(first))
    judged = f"{JUDGED[first.purpose].capitalize()}."
    notes = [note, f"± half the {labels}", judged]
    return TextTable(
        title,
        ("update", "episodes", *_HEADINGS),
        tuple(zip(map(str, first.updates), map(str, first.episodes), *texts, strict=True)),
        tuple(filter(None, notes)) if brief else (_join(f"In brackets: {labels}.", note, judged),),
    )


def difference_table(
    reference: Sequence[AdaptationTable],
    others: Mapping[str, Sequence[AdaptationTable]],
    title: str,
) -> TextTable:
    """Compare last updates with a reference on the same tasks: method minus reference, paired.

    There is one table per seed, of the reference and of each method by its name.
    """
    rows, intervals = [], []
    for name, tables in others.items():
        ends = [[stack_seeds(x, one)[..., -1] for x in (tables, reference)] for one in MEASURES]
        found = [bootstrap(difference, *pair) for pair in ends]
        units = zip(UNITS.values(), found, strict=True)
        rows.append((name, *(unit.ends(interval, sign="+") for unit, interval in units)))
        intervals += found
    beyond = [f"{name}: {said}" for name, tables in others.items() if (said := _beyond(tables[0]))]
    solved = note_on_solved(solved_at_reset(reference))
    note = _join(f"In brackets: {labels_of(intervals)}.", solved, *beyond)
    return TextTable(title, ("method", *_HEADINGS), tuple(rows), (note,), is_named=True)


def print_adaptation_summary(path: Path, console: Console | None = None) -> None:
    """Show one table of `maesn adapt` in the terminal.

    Where there are ten tasks or fewer, each has a row. On sparse reward, it is said in how many
    tasks no episode reached the goal.

    Raises:
        RunError: the file is missing or broken.
    """
    console = console or Console()
    table, title = read_adaptation(path), f"Adaptation: {path.stem}"
    few = [_task_table(table)] if table.num_tasks <= _FEW_TASKS else []
    print_tables([*summary_tables([table], title, brief=True), *few], console)
    failed = int((table.explored_success_rate == 0).all(axis=1).sum())
    if failed and table.reward == "sparse" and len(table.updates) > 1:
        console.print(
            f"No episode reached the goal in {failed} of {table.num_tasks} tasks: there the "
            "adaptation had nothing to learn from.",
            highlight=False,
        )


def _task_table(table: AdaptationTable) -> TextTable:
    """Return one row per task: before the first update, and after the last."""
    columns = [
        [UNITS[name].number(value) for value in table.measure(name)[:, column]]
        for name in ("mean_return", "success_rate")
        for column in (0, -1)
    ]
    return TextTable(
        f"Each task, before and after {table.updates[-1]} updates",
        ("task", "return before", "after", "reaches goal (%) before", "after"),
        tuple(zip(map(str, range(table.num_tasks)), *columns, strict=True)),
    )


def note_on_solved(solved: Bool[np.ndarray, " task"]) -> str:
    """Say how many tasks need not be solved, because their episodes start in the goal region."""
    count, verb = int(solved.sum()), "is" if solved.sum() == 1 else "are"
    return f"{count} of the {len(solved)} tasks {verb} solved at reset." if count else ""


def labels_of(intervals: Iterable[Interval]) -> str:
    """Return what intervals are and resample, each text once."""
    return "; or ".join(dict.fromkeys(interval.label for interval in intervals))


def _beyond(table: AdaptationTable) -> str:
    """Say from where on a method does what it was never trained for; empty for nowhere."""
    if table.first_beyond is None:
        return ""
    return (
        f"Meta-training has prepared for {table.trial_episodes} episodes: from update "
        f"{table.updates[table.first_beyond]} on it is beyond them."
    )


def _join(*sentences: str) -> str:
    return " ".join(filter(None, sentences))
