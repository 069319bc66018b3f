"""What a comparison comes to, as tables: where the methods end, and who beats whom."""

from itertools import combinations
from pathlib import Path

from rich.console import Console

from maesn.report.adaptation_table import Line, note_on_judging
from maesn.report.comparison import Comparison
from maesn.report.statistics import (
    Interval,
    improvement_interval,
    interquartile_mean_interval,
    mean_interval,
    score_interval,
)
from maesn.report.tables import (
    UNITS,
    WITHOUT_SOLVED,
    TextTable,
    Unit,
    labels_of,
    note_on_solved,
    print_tables,
)
from maesn.storage import write_whole

_SCORE = Unit("score", digits=2)
_SCORE_INTERVAL = (
    "The score's interval draws the same tasks for method, baseline and oracle; there is none if "
    "in some of the draws the oracle is not above the baseline."
)
_PROBABILITY = Unit("probability", digits=2)


def summary_tables(comparison: Comparison) -> list[TextTable]:
    """Return where each method ends and, if there are several, who beats whom.

    Where some methods were adapted to the first tasks alone, a second table has all methods in
    these. Where some tasks are solved at reset, another one has the methods in the others.
    """
    tables = [_ends(comparison)]
    fewest = min(line.num_tasks for line in comparison.lines)
    if fewest < max(line.num_tasks for line in comparison.everyone):
        tables.append(_ends(comparison.of_first(fewest), f", the first {fewest} alone"))
    unsolved = ~comparison.is_solved_at_reset
    others = comparison.of_tasks(unsolved)
    if others.lines and not unsolved.all():
        tables.append(_ends(others, f", {WITHOUT_SOLVED}"))
    if len(comparison.lines) > 1:
        tables.append(_improvements(comparison))
    return tables


def write_summary(comparison: Comparison, path: Path) -> None:
    """Write the tables as Markdown; a `RunError` says why they cannot be written."""
    texts = [table.to_markdown() for table in summary_tables(comparison)]
    write_whole(path, "\n".join(texts).encode())


def print_summary(comparison: Comparison, console: Console | None = None) -> None:
    """Show the tables in the terminal, by default on standard output."""
    print_tables(summary_tables(comparison), console)


def _ends(comparison: Comparison, addition: str = "") -> TextTable:
    first, lines = comparison.lines[0].table, comparison.lines
    intervals: list[Interval] = []
    rows = [_end(comparison, line, intervals) for line in comparison.everyone]
    is_trained = any(line.training_steps is not None for line in comparison.everyone)
    scoreless = [row["method"] for row in rows[: len(lines)] if not row["score"]]
    notes = [
        f"Mean and interquartile mean (IQM) of the {first.reward}-reward curves' last points.",
        f"Methods {note_on_judging(lines)}.",
        f"In brackets: {labels_of(intervals)}.",
        "Trained on: environment steps of meta-training." if is_trained else "",
        note_on_solved(comparison.is_solved_at_reset),
        *map(_beyond, lines),
        comparison.why_no_score or _SCORE_INTERVAL,
    ]
    if scoreless and not comparison.why_no_score:
        notes.append(
            f"No score of {', '.join(scoreless)}: on these tasks the oracle is not above the "
            "baseline."
        )
    return TextTable(
        f"After each method's last update, in {first.tasks} tasks{addition}",
        tuple(rows[0]),
        tuple(tuple(row.values()) for row in rows),
        tuple(filter(None, notes)),
        is_named=True,
    )


def _end(comparison: Comparison, line: Line, intervals: list[Interval]) -> dict[str, str]:
    """Return one method's row by headings, and append the intervals of its returns."""
    last, steps = line.measure("mean_return")[..., -1], line.training_steps
    returns, middle = mean_interval(last), interquartile_mean_interval(last)
    success = mean_interval(line.measure("success_rate")[..., -1])
    intervals += [returns, middle]
    return {
        "method": line.label,
        "trained on": "" if steps is None else f"{steps / 1e6:.3g} M",
        "seeds": str(len(line.seeds)),
        "tasks": str(line.num_tasks),
        "updates": str(line.table.updates[-1]),
        "steps": f"{comparison.steps(line)[-1]:,}",
        "return": UNITS["mean_return"].ends(returns),
        "IQM": UNITS["mean_return"].ends(middle),
        "reaches goal (%)": UNITS["success_rate"].ends(success),
        "score": _score(comparison, line),
    }


def _score(comparison: Comparison, line: Line) -> str:
    """Return the score of the last point with its interval; empty if there is no score."""
    last, oracle = line.measure("mean_return")[..., -1], comparison.oracle
    if oracle is None or comparison.score(last, line.num_tasks) is None:
        return ""
    ceiling, *baselines = (
        one.measure("mean_return")[:, : line.num_tasks, 0]
        for one in (oracle, *comparison.baselines)
    )
    return _SCORE.ends(score_interval(last, baselines, ceiling))


def _beyond(line: Line) -> str:
    """Say where a method ends within what it was trained for; empty if all of it is within."""
    if line.table.first_beyond is None:
        return ""
    last = line.table.first_beyond - 1
    prepared = mean_interval(line.measure("mean_return")[..., last])
    return (
        f"{line.label} was trained for trials of {line.table.trial_episodes} episodes, and is "
        f"beyond them from update {last + 1} on: after update {last}, the last that it was trained "
        f"for, its return is {UNITS['mean_return'].ends(prepared)}."
    )


def _improvements(comparison: Comparison) -> TextTable:
    """Compare the methods' last points in pairs, over the tasks that both have."""
    rows, intervals = [], []
    for pair in combinations(comparison.lines, 2):
        both = min(line.num_tasks for line in pair)
        ends = [line.measure("mean_return")[:, :both, -1] for line in pair]
        intervals.append(improvement_interval(*ends))
        rows.append((*(line.label for line in pair), _PROBABILITY.ends(intervals[-1])))
    beyond = [
        f"{line.label}: after update {line.table.updates[-1]}, beyond its trials."
        for line in comparison.lines
        if line.table.first_beyond is not None
    ]
    return TextTable(
        "Probability that the first method's last point is above the second's in a task",
        ("first", "second", "probability"),
        tuple(rows),
        (f"In brackets: {labels_of(intervals)}. A tie counts as half a win.", *beyond),
        is_named=True,
    )
