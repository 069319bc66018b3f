"""Tables of numbers with their intervals, for the terminal and as Markdown."""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool
from rich.console import Console
from rich.table import Table
from rich.text import Text

from maesn.reporting import statistics
from maesn.reporting.comparison import Comparison, Line, note_on_judging, note_on_training
from maesn.reporting.reading import AdaptationTable, count_of, read_adaptation, stack_seeds
from maesn.reporting.statistics import INTERVAL, Interval, bootstrap, curve
from maesn.reporting.style import MethodStyle
from maesn.settings import leaves

_MAX_WIDTH = 120  # columns that a table may take where numbers need them
_FEW_TASKS = 10  # each has a row of its own
_SHOWN_EPISODES = (0, 1, 2, 3, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
_NO_SCORE = (
    "a method has no score without an oracle above the baseline on its tasks: name one (`oracle` "
    "in a study, --oracle DIR of `maesn compare`)"
)


class Unit(NamedTuple):
    """The heading and the format of one measure."""

    heading: str
    scale: float = 1.0
    digits: int = 1

    def number(self, value: float) -> str:
        """Return the number as text, 0 without a minus; NaN as a dash."""
        return "-" if np.isnan(value) else format(self.scale * value, f"z.{self.digits}f")

    def text(self, interval: Interval, *, brief: bool = False) -> str:
        """Return the mean and the ends of its interval or, if `brief`, half its width."""
        mean = self.number(interval.mean)
        if not interval.is_known:
            return mean
        if brief:
            return f"{mean} ±{self.number((interval.high - interval.low) / 2)}"
        return f"{mean} [{self.number(interval.low)}, {self.number(interval.high)}]"


UNITS = {
    "mean_return": Unit("return"),
    "goal_return": Unit("goal return"),
    "success_rate": Unit("reaches goal (%)", 100.0),
    "final_success_rate": Unit("ends at goal (%)", 100.0),
    "time_in_region": Unit("time at goal (%)", 100.0),
}
_SHARE = Unit("", digits=2)  # scores and probabilities


class TextTable(NamedTuple):
    """A table of texts, with a title above and sentences below."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    @property
    def _first_is_name(self) -> bool:
        """Whether the first column holds names: they stand at the left, numbers at the right."""
        return not all(row[0].isdigit() for row in self.rows)

    def to_rich(self) -> Table:
        """Return the table for a terminal."""
        table = Table(title=self.title, caption="\n".join(self.notes), box=None)
        for heading, *cells in zip(self.headings, *self.rows, strict=True):
            # A heading may be broken between words, a number may not be broken.
            widest = max(map(len, [*heading.split(), *cells]))
            table.add_column(heading, justify="right", min_width=widest)
        if self._first_is_name:
            table.columns[0].justify = "left"
        for row in self.rows:
            table.add_row(*map(Text, row))
        return table

    def to_markdown(self) -> str:
        """Return the table as Markdown."""
        ruler = ["---" if self._first_is_name else "---:", *["---:"] * (len(self.headings) - 1)]
        lines = [f"| {' | '.join(row)} |" for row in (self.headings, ruler, *self.rows)]
        return "\n".join([f"**{self.title}**", "", *lines, "", *self.notes, ""])


def print_tables(tables: Sequence[TextTable], console: Console | None = None) -> None:
    """Show tables in the terminal. A narrow one may break lines, but no number is cut off."""
    console = console or Console()
    for table in tables:
        console.print(table.to_rich(), width=max(console.width, _MAX_WIDTH), crop=False)


def adaptation_tables(path: Path) -> list[TextTable]:
    """Summarise a table of `maesn adapt`, update by update, in 80 columns.

    A second summary leaves out the tasks that are solved at reset, where there are some. Of ten
    tasks or fewer, each has a row. A `RunError` says if the file is missing or broken.
    """
    table = stack_seeds([read_adaptation(path)])
    settings = leaves({"evaluation": table.about})
    line = Line("", MethodStyle("the method"), (0,), table, settings=settings)
    parts = Comparison((line,)).parts().items()
    tables = [_by_update(part.lines[0], f"Adaptation: {path.stem}{more}") for more, part in parts]
    if table.num_tasks <= _FEW_TASKS:
        tables.append(_by_task(table))
    return tables


def _by_update(line: Line, title: str) -> TextTable:
    table = line.table
    columns = [
        [unit.text(one, brief=True) for one in curve(line.measure(name)).points]
        for name, unit in UNITS.items()
    ]
    failed = int((table.explored_success_rate == 0).all(axis=(0, -1)).sum())
    is_blind = failed and table.reward == "sparse" and len(table.updates) > 1
    return TextTable(
        title,
        ("update", "episodes", *(unit.heading for unit in UNITS.values())),
        tuple(zip(map(str, table.updates), map(str, table.episodes), *columns, strict=True)),
        sentences(
            _end_in_words(line),
            note_on_solved(table.is_solved_at_reset),
            line.beyond,
            f"± half the {INTERVAL}; brackets hold its ends",
            note_on_judging([line]),
            note_on_training([line]),
            _failures(failed, table.num_tasks) if is_blind else "",
        ),
    )


def _failures(failed: int, num_tasks: int) -> str:
    """Say in how many tasks no episode reached the goal: in all of them there may be none."""
    if failed == num_tasks:
        return (
            "no episode reached a goal: if the reward is the same everywhere else, there was "
            "nothing to learn from"
        )
    return (
        f"no episode reached the goal in {failed} of {num_tasks} tasks: there the adaptation had "
        "nothing to learn from"
    )


def _end_in_words(line: Line) -> str:
    reported = line.settings.get("evaluation.measure")
    names = (reported,) if reported else ("success_rate", "mean_return")
    known = [x for x in names if not np.isnan(line.column(-1, x)).all()] or ["mean_return"]
    means = (bootstrap(statistics.mean, line.column(-1, name)) for name in known)
    found = (
        f"{UNITS[name].heading} {UNITS[name].text(x)}" for name, x in zip(known, means, strict=True)
    )
    done = f"after {count_of(line.table.episodes[-1])} in each of {line.table.num_tasks} tasks"
    text = f"{done}: {', '.join(found)}"
    if line.num_tasks >= statistics.FEWEST_TASKS:
        worst = UNITS["mean_return"].text(bootstrap(statistics.cvar, line.column(-1)))
        text += f"; return in the worst tenth of the tasks {worst}"
    return text


def _by_task(table: AdaptationTable) -> TextTable:
    """Return one row per task: before the first update, and after the last."""
    columns = [
        [UNITS[name].number(value) for value in getattr(table, name)[0, :, column]]
        for name in ("mean_return", "success_rate")
        for column in (0, -1)
    ]
    return TextTable(
        f"Each task, before and after {table.updates[-1]} updates",
        ("task", "return before", "after", "reaches goal (%) before", "after"),
        tuple(zip(map(str, range(table.num_tasks)), *columns, strict=True)),
    )


def summary_tables(comparison: Comparison) -> list[TextTable]:
    """Return where each method ends, how it gets there, and who beats whom."""
    tables = [_ends(part, addition) for addition, part in comparison.parts().items()]
    tables += [_by_episodes(comparison, name) for name in comparison.headline_measures]
    if len(comparison.lines) > 1:
        tables.append(_improvements(comparison))
    if not comparison.name:
        return tables
    titles = (f"{comparison.name}: {table.title[0].lower()}{table.title[1:]}" for table in tables)
    return [table._replace(title=title) for table, title in zip(tables, titles, strict=True)]


def to_page(tables: Sequence[TextTable]) -> str:
    """Return tables as a page of Markdown."""
    return "\n".join(table.to_markdown() for table in tables)


def _ends(comparison: Comparison, addition: str) -> TextTable:
    first = comparison.lines[0].table
    rows = [_end(comparison, line) for line in comparison.everyone]
    methods = rows[: len(comparison.lines)]
    headings = tuple(name for name in rows[0] if name == "score" or any(row[name] for row in rows))
    return TextTable(
        f"After each method's last update, in {first.tasks} tasks{addition}",
        headings,
        tuple(tuple(row[name] for name in headings) for row in rows),
        sentences(
            f"means of the {first.reward}-reward curves' last points",
            note_on_judging(comparison.lines),
            note_on_training(comparison.lines),
            f"in brackets: {INTERVAL}",
            "trained on: environment steps of meta-training" if "trained on" in headings else "",
            note_on_solved(comparison.is_solved_at_reset),
            *(line.beyond for line in comparison.lines),
            "" if all(row["score"] for row in methods) else _NO_SCORE,
        ),
    )


def _end(comparison: Comparison, line: Line) -> dict[str, str]:
    """Return one method's row, by headings."""
    last, steps = line.column(-1), line.training_steps
    score = ""
    if comparison.oracle and comparison.baselines:
        rivals = (*comparison.oracle, *comparison.baselines)
        bounds = (one.column(0, num_tasks=line.num_tasks) for one in rivals)
        found = bootstrap(statistics.score, last, *bounds)
        score = "" if np.isnan(found.mean) else _SHARE.text(found)
    returns, success = UNITS["mean_return"], UNITS["success_rate"]
    return {
        "method": line.label,
        "trained on": "" if steps is None else f"{steps / 1e6:.3g} M",
        "seeds": str(len(line.seeds)),
        "tasks": str(line.num_tasks),
        "updates": str(line.table.updates[-1]),
        "steps": f"{line.table.episodes[-1] * comparison.horizon:,}" if comparison.horizon else "",
        "return": returns.text(bootstrap(statistics.mean, last)),
        success.heading: success.text(bootstrap(statistics.mean, line.column(-1, "success_rate"))),
        "score": score,
    }


def _by_episodes(comparison: Comparison, measure: str) -> TextTable:
    """Return a measure of each method after some numbers of episodes in the new task."""
    unit, rows, notes = UNITS[measure], [], [f"± half the {INTERVAL}"]
    for line in comparison.lines:
        points = curve(line.measure(measure)).points
        texts = [unit.text(point, brief=True) for point in points]
        rows.append((line.label, dict(zip(line.table.episodes.tolist(), texts, strict=True))))
        if line.published is not None and measure == "mean_return":
            episodes = line.published.update.astype(int) * (line.table.episodes_per_update or 1)
            texts = [unit.number(value) for value in line.published.mean_return]
            published = dict(zip(episodes.tolist(), texts, strict=True))
            rows.append((f"{line.label}, published", published))
            notes = [notes[0], "published: means over other tasks, one seed"]
    shown = [n for n in _SHOWN_EPISODES if any(n in texts for _, texts in rows)]
    return TextTable(
        f"Episodes in the new task, and {unit.heading}",
        ("method", *map(str, shown)),
        tuple((label, *(texts.get(n, "") for n in shown)) for label, texts in rows),
        sentences(*notes, note_on_judging(comparison.lines), note_on_training(comparison.lines)),
    )


def _improvements(comparison: Comparison) -> TextTable:
    """Compare the methods' last points in pairs, over the tasks that both have."""
    rows = []
    for pair in combinations(comparison.lines, 2):
        both = min(line.num_tasks for line in pair)
        ends = [line.column(-1, num_tasks=both) for line in pair]
        if pair[0].has_policies_of(pair[1]):
            better = bootstrap(statistics.mean, statistics.wins(*ends))
        else:
            better = bootstrap(statistics.improvement, *ends)
        rows.append((*(line.label for line in pair), _SHARE.text(better)))
    return TextTable(
        "Probability that the first method's last point is above the second's in a task",
        ("first", "second", "probability"),
        tuple(rows),
        sentences(
            f"in brackets: {INTERVAL}. A tie counts as half a win. Lines of the same trained "
            "policies are compared policy by policy, others by all pairs of seeds"
        ),
    )


def sentences(*notes: str) -> tuple[str, ...]:
    """Return the notes that are not empty as sentences."""
    return tuple(f"{note[0].upper()}{note[1:]}." for note in notes if note)


def note_on_solved(solved: Bool[np.ndarray, " task"]) -> str:
    """Say how many tasks need not be solved, because their episodes start in the goal region."""
    count = int(solved.sum())
    return f"{count} of the {len(solved)} tasks are solved at reset" if count else ""
