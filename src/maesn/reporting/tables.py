"""Tables of numbers with their intervals, for the terminal and as Markdown."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool
from rich.console import Console
from rich.table import Table
from rich.text import Text

from maesn.reporting.comparison import Comparison, Line, note_on_judging
from maesn.reporting.reading import AdaptationTable, read_adaptation, stack_seeds
from maesn.reporting.statistics import Interval, curve
from maesn.reporting.style import MethodStyle

_MAX_WIDTH = 120  # columns that a table may take where numbers need them
_FEW_TASKS = 10  # each has a row of its own
_SHOWN_EPISODES = (0, 1, 2, 5, 10, 20, 50, 100, 200, 500)  # about equal steps of their logarithm


class Unit(NamedTuple):
    """How one measure is printed."""

    heading: str
    scale: float = 1.0
    digits: int = 1

    def number(self, value: float, sign: str = "") -> str:
        """Return the number as text, 0 without a minus; `sign` as in format specifications."""
        return format(self.scale * value, f"{sign}z.{self.digits}f")

    def text(self, interval: Interval, sign: str = "", *, brief: bool = False) -> str:
        """Return the mean and the ends of its interval or, if `brief`, half its width."""
        mean = self.number(interval.mean, sign)
        if not interval.is_known:
            return mean
        if brief:
            return f"{mean} ±{self.number((interval.high - interval.low) / 2)}"
        return f"{mean} [{self.number(interval.low, sign)}, {self.number(interval.high, sign)}]"

    def texts(self, intervals: Interval, *, brief: bool = False) -> list[str]:
        """Return the texts of the points of a curve."""
        return [self.text(one, brief=brief) for one in intervals.points]


UNITS = {
    "mean_return": Unit("return"),
    "goal_return": Unit("goal return"),
    "success_rate": Unit("reaches goal (%)", 100.0),
    "final_success_rate": Unit("ends at goal (%)", 100.0),
    "time_in_region": Unit("time at goal (%)", 100.0),
}
_MAIN = ("mean_return", "success_rate")  # where there is little room


class TextTable(NamedTuple):
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


def update_tables(
    tables: Sequence[AdaptationTable], title: str, *, brief: bool = False
) -> list[TextTable]:
    """Summarise adaptation, update by update: one table per seed of the same method is given.

    A second summary leaves out the tasks that are solved at reset, where there are some. Summaries
    that are `brief` fit into 80 columns.
    """
    seeds = tuple(range(len(tables)))
    comparison = Comparison((Line("", MethodStyle("the method"), seeds, stack_seeds(tables)),))
    parts = comparison.parts().items()
    return [_update_table(part.lines[0], title + addition, brief) for addition, part in parts]


def _update_table(line: Line, title: str, brief: bool) -> TextTable:
    table = line.table
    intervals = {name: curve(line.measure(name)) for name in UNITS}
    texts = [UNITS[name].texts(one, brief=brief) for name, one in intervals.items()]
    labels = labels_of(intervals.values())
    return TextTable(
        title,
        ("update", "episodes", *(unit.heading for unit in UNITS.values())),
        tuple(zip(map(str, table.updates), map(str, table.episodes), *texts, strict=True)),
        sentences(
            note_on_solved(table.is_solved_at_reset),
            line.beyond,
            f"± half the {labels}" if brief else f"in brackets: {labels}",
            note_on_judging([line]),
        ),
    )


def print_adaptation_summary(path: Path, console: Console | None = None) -> None:
    """Show one table of `maesn adapt` in the terminal.

    Where there are ten tasks or fewer, each has a row. On sparse reward, it is said in how many
    tasks no episode reached the goal. A `RunError` says if the file is missing or broken.
    """
    console = console or Console()
    table = read_adaptation(path)
    shown = update_tables([table], f"Adaptation: {path.stem}", brief=True)
    if table.num_tasks <= _FEW_TASKS:
        shown.append(_task_table(table))
    print_tables(shown, console)
    failed = int((table.explored_success_rate == 0).all(axis=1).sum())
    if failed and table.reward == "sparse" and len(table.updates) > 1:
        console.print(
            f"No episode reached the goal in {failed} of {table.num_tasks} tasks: there the "
            "adaptation had nothing to learn from.",
            highlight=False,
        )


def print_side_by_side(
    paths: Mapping[str, Path], title: str, console: Console | None = None
) -> None:
    """Show tables of `maesn adapt` by name, at numbers of episodes from 0 to the last."""
    rows: list[tuple[str, ...]] = []
    for name, path in paths.items():
        found = read_adaptation(path)
        shown = np.isin(found.episodes, [*_SHOWN_EPISODES, found.episodes[-1]])
        curves = {one: getattr(found, one)[None, :, shown] for one in _MAIN}
        cells = [UNITS[one].texts(curve(values), brief=True) for one, values in curves.items()]
        rows += zip([name] * shown.sum(), map(str, found.episodes[shown]), *cells, strict=True)
    headings = ("rule", "episodes", *(UNITS[one].heading for one in _MAIN))
    print_tables([TextTable(title, headings, tuple(rows), is_named=True)], console)


def _task_table(table: AdaptationTable) -> TextTable:
    """Return one row per task: before the first update, and after the last."""
    columns = [
        [UNITS[name].number(value) for value in getattr(table, name)[:, column]]
        for name in _MAIN
        for column in (0, -1)
    ]
    return TextTable(
        f"Each task, before and after {table.updates[-1]} updates",
        ("task", "return before", "after", "reaches goal (%) before", "after"),
        tuple(zip(map(str, range(table.num_tasks)), *columns, strict=True)),
    )


def sentences(*notes: str) -> tuple[str, ...]:
    """Return the notes that are not empty as sentences."""
    return tuple(f"{note[0].upper()}{note[1:]}." for note in notes if note)


def note_on_solved(solved: Bool[np.ndarray, " task"]) -> str:
    """Say how many tasks need not be solved, because their episodes start in the goal region."""
    count, verb = int(solved.sum()), "is" if solved.sum() == 1 else "are"
    return f"{count} of the {len(solved)} tasks {verb} solved at reset" if count else ""


def labels_of(intervals: Iterable[Interval]) -> str:
    """Return what intervals are and resample, each text once."""
    return "; or ".join(dict.fromkeys(interval.label for interval in intervals))
