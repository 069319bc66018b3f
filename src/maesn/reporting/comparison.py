"""Methods adapted to the same tasks: scores, the tidy table, where methods end, who beats whom."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from maesn.reporting import statistics, tables
from maesn.reporting.adaptation_table import Line, note_on_judging, solved_at_reset
from maesn.reporting.statistics import Interval, bootstrap
from maesn.reporting.tables import UNITS, TextTable, Unit

_SCORE = Unit("score", digits=2)
_SCORE_INTERVAL = (
    "The score's interval draws the same tasks for method, baseline and oracle; there is none if "
    "in some of the draws the oracle is not above the baseline."
)
_PROBABILITY = Unit("probability", digits=2)


@dataclass(frozen=True)
class Comparison:
    """Methods on the same tasks, and the references below and above them."""

    lines: tuple[Line, ...]
    horizon: int
    """Steps of an episode that runs its full time."""
    baselines: tuple[Line, ...]
    """Agents that learn nothing; the one with the better mean return is the baseline."""
    oracle: Line | None = None
    """The agent that is given the task; None if no run of it was named."""

    @property
    def everyone(self) -> tuple[Line, ...]:
        """The methods, then baselines and oracle."""
        return (*self.lines, *self.baselines, *(() if self.oracle is None else (self.oracle,)))

    @property
    def is_solved_at_reset(self) -> Bool[np.ndarray, " task"]:
        """Which tasks some episode starts in the goal region of."""
        return solved_at_reset([table for line in self.baselines for table in line.tables])

    def steps(self, line: Line) -> Int[np.ndarray, " update"]:
        """Return the steps per task that a method has learned from, of episodes of full length."""
        return line.table.episodes * self.horizon

    def bounds(self, num_tasks: int) -> tuple[float, float | None]:
        """Return the mean returns of baseline and oracle over the first so many tasks."""
        baseline = max(_start(line, num_tasks).mean() for line in self.baselines)
        oracle = None if self.oracle is None else float(_start(self.oracle, num_tasks).mean())
        return float(baseline), oracle

    def score(
        self, returns: Float[np.ndarray, "*batch"], num_tasks: int
    ) -> Float[np.ndarray, "*batch"] | None:
        """Return the score of returns in the first so many tasks; None where it has no meaning.

            score = (return - baseline) / (oracle - baseline), never clipped

        with the means of baseline and oracle over the same tasks.
        """
        baseline, oracle = self.bounds(num_tasks)
        if oracle is None or oracle <= baseline:
            return None
        return (returns - baseline) / (oracle - baseline)

    @property
    def why_no_score(self) -> str:
        """Say in a sentence why there is no score; empty if there is one."""
        if self.oracle is None:
            return (
                "No score: it needs an oracle; give the run of one with --oracle DIR (maesn train "
                "oracle)."
            )
        baseline, oracle = self.bounds(self.oracle.num_tasks)
        if oracle is None or oracle > baseline:
            return ""
        return (
            f"No score: the oracle's mean return {oracle:.1f} is not above the baseline's "
            f"{baseline:.1f}; train it for longer."
        )

    def of_tasks(self, chosen: Bool[np.ndarray, " task"]) -> "Comparison":
        """Return the comparison over some of the tasks; methods that have none of them drop out."""
        lines = [line.of_tasks(chosen) for line in self.lines if chosen[: line.num_tasks].any()]
        baselines = tuple(line.of_tasks(chosen) for line in self.baselines)
        oracle = None if self.oracle is None else self.oracle.of_tasks(chosen)
        return replace(self, lines=tuple(lines), baselines=baselines, oracle=oracle)


def tidy_rows(comparison: Comparison) -> Iterator[dict[str, Any]]:
    """Yield one row per method, seed, task and update; `score` is empty if there is none.

    Measures are in the single precision of the curves, so that they are written with its digits.
    """
    solved = comparison.is_solved_at_reset
    for line in comparison.everyone:
        steps = comparison.steps(line)
        for seed, table in zip(line.seeds, line.tables, strict=True):
            scores = comparison.score(table.mean_return, line.num_tasks)
            for task, column in np.ndindex(table.mean_return.shape):
                measures = ("mean_return", "goal_return", "success_rate")
                yield {
                    "method": line.name,
                    "seed": seed,
                    "task": task,
                    "update": table.updates[column],
                    "purpose": table.purpose,
                    "steps": steps[column],
                    **{name: np.float32(table.measure(name)[task, column]) for name in measures},
                    "score": "" if scores is None else np.float32(scores[task, column]),
                    "solved_at_reset": int(solved[task]),
                }


def summary_tables(comparison: Comparison) -> list[TextTable]:
    """Return where each method ends and, if there are several, who beats whom.

    Where some methods were adapted to the first tasks alone, a second table has all methods in
    these. Where some tasks are solved at reset, another one has the methods in the others.
    """
    unsolved = ~comparison.is_solved_at_reset
    found = [_ends(comparison)]
    fewest = min(line.num_tasks for line in comparison.lines)
    if fewest < max(line.num_tasks for line in comparison.everyone):
        first = comparison.of_tasks(np.arange(len(unsolved)) < fewest)
        found.append(_ends(first, f", the first {fewest} alone"))
    others = comparison.of_tasks(unsolved)
    if others.lines and not unsolved.all():
        found.append(_ends(others, f", {tables.WITHOUT_SOLVED}"))
    if len(comparison.lines) > 1:
        found.append(_improvements(comparison))
    return found


def _ends(comparison: Comparison, addition: str = "") -> TextTable:
    first, lines = comparison.lines[0].table, comparison.lines
    intervals: list[Interval] = []
    rows = [_end(comparison, line, intervals) for line in comparison.everyone]
    is_trained = any(line.training_steps is not None for line in comparison.everyone)
    scoreless = ", ".join(row["method"] for row in rows[: len(lines)] if not row["score"])
    notes = [
        f"Mean and interquartile mean (IQM) of the {first.reward}-reward curves' last points.",
        f"Methods {note_on_judging(lines)}.",
        f"In brackets: {tables.labels_of(intervals)}.",
        "Trained on: environment steps of meta-training." if is_trained else "",
        tables.note_on_solved(comparison.is_solved_at_reset),
        *map(_beyond, lines),
        comparison.why_no_score or _SCORE_INTERVAL,
    ]
    if scoreless and not comparison.why_no_score:
        notes.append(
            f"No score of {scoreless}: on these tasks the oracle is not above the baseline."
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
    returns, middle = (bootstrap(x, last) for x in (statistics.mean, statistics.interquartile_mean))
    success = bootstrap(statistics.mean, line.measure("success_rate")[..., -1])
    intervals += [returns, middle]
    score, oracle = "", comparison.oracle
    if oracle is not None and comparison.score(last, line.num_tasks) is not None:
        bounds = [_start(one, line.num_tasks) for one in (oracle, *comparison.baselines)]
        score = _SCORE.text(bootstrap(statistics.score, last, *bounds))
    return {
        "method": line.label,
        "trained on": "" if steps is None else f"{steps / 1e6:.3g} M",
        "seeds": str(len(line.seeds)),
        "tasks": str(line.num_tasks),
        "updates": str(line.table.updates[-1]),
        "steps": f"{comparison.steps(line)[-1]:,}",
        "return": UNITS["mean_return"].text(returns),
        "IQM": UNITS["mean_return"].text(middle),
        "reaches goal (%)": UNITS["success_rate"].text(success),
        "score": score,
    }


def _start(line: Line, num_tasks: int) -> Float[np.ndarray, "seed task"]:
    """Return the returns before any update."""
    return line.measure("mean_return")[:, :num_tasks, 0]


def _beyond(line: Line) -> str:
    """Say where a method ends within what it was trained for; empty if all of it is within."""
    if line.table.first_beyond is None:
        return ""
    last = line.table.first_beyond - 1
    prepared = bootstrap(statistics.mean, line.measure("mean_return")[..., last])
    return (
        f"{line.label} was trained for trials of {line.table.trial_episodes} episodes, and is "
        f"beyond them from update {last + 1} on: after update {last}, the last that it was trained "
        f"for, its return is {UNITS['mean_return'].text(prepared)}."
    )


def _improvements(comparison: Comparison) -> TextTable:
    """Compare the methods' last points in pairs, over the tasks that both have."""
    rows, intervals = [], []
    for pair in combinations(comparison.lines, 2):
        both = min(line.num_tasks for line in pair)
        ends = [line.measure("mean_return")[:, :both, -1] for line in pair]
        intervals.append(bootstrap(statistics.improvement, *ends))
        rows.append((*(line.label for line in pair), _PROBABILITY.text(intervals[-1])))
    beyond = [
        f"{line.label}: after update {line.table.updates[-1]}, beyond its trials."
        for line in comparison.lines
        if line.table.first_beyond is not None
    ]
    labels = tables.labels_of(intervals)
    return TextTable(
        "Probability that the first method's last point is above the second's in a task",
        ("first", "second", "probability"),
        tuple(rows),
        (f"In brackets: {labels}. A tie counts as half a win.", *beyond),
        is_named=True,
    )
