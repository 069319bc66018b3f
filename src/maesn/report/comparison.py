"""Methods adapted to the same tasks: what a comparison holds, its score and its tidy table."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from maesn.report.adaptation_table import (
    MEASURES,
    SOLVED_AT_RESET,
    AdaptationTable,
    stack_seeds,
)
from maesn.report.reading import writing
from maesn.report.style import MethodStyle
from maesn.storage import RunError

COLUMNS = (
    "method",
    "seed",
    "task",
    "update",
    "steps",
    "mean_return",
    "goal_return",
    "success_rate",
    "score",
    SOLVED_AT_RESET,
)


@dataclass(frozen=True)
class Line:
    """One method of a comparison."""

    name: str
    style: MethodStyle
    seeds: tuple[int, ...]
    tables: tuple[AdaptationTable, ...]
    """One per seed, all of the first so many tasks and with as many updates."""
    training_steps: int | None = None
    """Environment steps of meta-training; None without any."""

    @property
    def label(self) -> str:
        """How the method is called in figures and tables."""
        return self.style.label

    @property
    def num_tasks(self) -> int:
        """Number of tasks, the first ones of the comparison's."""
        return self.tables[0].num_tasks

    def measure(self, name: str) -> Float[np.ndarray, "seed task update"]:
        """Return one measure of all seeds."""
        return stack_seeds(self.tables, name)

    def of_tasks(self, chosen: Bool[np.ndarray, " task"]) -> "Line":
        """Return the line over some of the tasks.

        Args:
            chosen: of all tasks of the comparison, those that stay.
        """
        tables = tuple(table.select(chosen[: self.num_tasks]) for table in self.tables)
        return replace(self, tables=tables)

    @property
    def first_beyond(self) -> int | None:
        """First column that lies beyond what meta-training has prepared for; None without one."""
        return self.tables[0].first_beyond

    @property
    def trial_episodes(self) -> int | None:
        """Number of episodes that meta-training has prepared for; None if there is no limit."""
        return self.tables[0].trial_episodes


@dataclass(frozen=True)
class Comparison:
    """Methods on the same tasks, and what lies below and above them."""

    lines: tuple[Line, ...]
    horizon: int
    """Steps of an episode that runs its full time."""
    floor: tuple[Line, ...]
    """Agents that learn nothing; the one with the better mean return is the floor."""
    oracle: Line | None = None
    """The agent that is told the task; None if no run of it was given."""

    def steps(self, line: Line) -> Int[np.ndarray, " update"]:
        """Return the environment steps per task that a method has learned from by then.

        Episodes that end early are counted with their full time, so that one number holds for all
        tasks.
        """
        return line.tables[0].episodes * self.horizon

    def bounds(self, num_tasks: int) -> tuple[float, float | None]:
        """Return mean return of floor and oracle over the first so many tasks, at the start."""
        floor = max(_start_return(line, num_tasks) for line in self.floor)
        return floor, None if self.oracle is None else _start_return(self.oracle, num_tasks)

    def score(
        self, returns: Float[np.ndarray, "*batch"], num_tasks: int
    ) -> Float[np.ndarray, "*batch"] | None:
        """Return the normalised score, never clipped; None where it has no meaning.

            score = (return - floor) / (oracle - floor)

        Floor and oracle are means over the same tasks, at the same reward: 0 is what learning
        nothing gives, 1 what being told the task gives.

        Args:
            returns: mean undiscounted returns.
            num_tasks: they are of the first so many tasks.
        """
        floor, oracle = self.bounds(num_tasks)
        if oracle is None or oracle <= floor:
            return None
        return (returns - floor) / (oracle - floor)

    @property
    def why_no_score(self) -> str:
        """Say in a sentence why there is no score; empty if there is one."""
        if self.oracle is None:
            return (
                "No score: it stands between the floor and an oracle; give the run of one with "
                "--oracle DIR (maesn train oracle)."
            )
        floor, oracle = self.bounds(self.oracle.num_tasks)
        if oracle is not None and oracle <= floor:
            return (
                f"No score: the oracle's mean return {oracle:.1f} is not above the floor's "
                f"{floor:.1f}; train it for longer."
            )
        return ""

    @property
    def is_solved_at_reset(self) -> Bool[np.ndarray, " task"]:
        """Which tasks some episode starts in the goal region of."""
        flags = [table.is_solved_at_reset for line in self.floor for table in line.tables]
        return np.asarray(np.any(flags, axis=0))

    def of_tasks(self, chosen: Bool[np.ndarray, " task"]) -> "Comparison":
        """Return the comparison over some of the tasks; methods that have none of them drop out."""
        return replace(
            self,
            lines=tuple(
                line.of_tasks(chosen) for line in self.lines if chosen[: line.num_tasks].any()
            ),
            floor=tuple(line.of_tasks(chosen) for line in self.floor),
            oracle=None if self.oracle is None else self.oracle.of_tasks(chosen),
        )

    def of_first(self, number: int) -> "Comparison":
        """Return the comparison over the first so many tasks."""
        return self.of_tasks(np.arange(self.floor[0].num_tasks) < number)

    @property
    def everyone(self) -> tuple[Line, ...]:
        """The methods, then floor and oracle."""
        return (*self.lines, *self.floor, *(() if self.oracle is None else (self.oracle,)))


def _start_return(line: Line, num_tasks: int) -> float:
    return float(line.measure("mean_return")[:, :num_tasks, 0].mean())


def first_part(table: AdaptationTable, num_tasks: int, updates: int) -> AdaptationTable:
    """Return the table of the first so many tasks and updates.

    Raises:
        RunError: if the table holds less.
    """
    columns = updates + 1
    if table.first_update or table.num_tasks < num_tasks or len(table.episodes) < columns:
        raise RunError(
            f"Expected {num_tasks} tasks with {updates} updates from the start, got "
            f"{table.num_tasks} tasks with updates {table.first_update} to "
            f"{int(table.updates[-1])}; delete the table and compare again."
        )
    names = MEASURES if table.solved_at_reset is None else (*MEASURES, SOLVED_AT_RESET)
    cut: dict[str, Any] = {name: getattr(table, name)[:num_tasks, :columns] for name in names}
    return replace(table, episodes=table.episodes[:columns], **cut)


def tidy_rows(comparison: Comparison) -> Iterator[dict[str, Any]]:
    """Yield one row per method, seed, task and update; `score` is empty if there is none.

    Measures are in the single precision of the curves, so that they are written with its digits.
    """
    solved = comparison.is_solved_at_reset
    for line in comparison.everyone:
        steps = comparison.steps(line)
        for seed, table in zip(line.seeds, line.tables, strict=True):
            scores = comparison.score(table.mean_return, line.num_tasks)
            for task in range(table.num_tasks):
                for column, update in enumerate(table.updates):
                    values = (
                        np.float32(table.mean_return[task, column]),
                        np.float32(table.goal_return[task, column]),
                        np.float32(table.success_rate[task, column]),
                        "" if scores is None else np.float32(scores[task, column]),
                        int(solved[task]),
                    )
                    row = (line.name, seed, task, int(update), int(steps[column]), *values)
                    yield dict(zip(COLUMNS, row, strict=True))


def write_tidy_table(comparison: Comparison, path: Path) -> None:
    """Write the tidy table as a `.csv` file.

    Raises:
        RunError: if it cannot be written.
    """
    with writing(path), path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(tidy_rows(comparison))


def paired(
    first: Line, second: Line, measure: str, update: int = -1
) -> tuple[np.ndarray, np.ndarray]:
    """Return one measure of two methods over the tasks that both have, `[seed, task]` each.

    Args:
        first: a method.
        second: another one.
        measure: which.
        update: after how many updates; -1 for each method's last.
    """
    both = min(first.num_tasks, second.num_tasks)
    one, other = (line.measure(measure)[:, :both, update] for line in (first, second))
    return one, other
