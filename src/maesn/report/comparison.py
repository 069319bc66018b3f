"""Methods adapted to the same tasks: what a comparison holds, its score and its tidy table."""

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from maesn.report.adaptation_table import Line, solved_at_reset
from maesn.storage import write_whole


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
        """Return the environment steps per task that a method has learned from by each update.

        Episodes that end early are counted with their full time, so that one number holds for all
        tasks.
        """
        return line.table.episodes * self.horizon

    def bounds(self, num_tasks: int) -> tuple[float, float | None]:
        """Return the mean returns of baseline and oracle over the first so many tasks."""
        baseline = max(_start_return(line, num_tasks) for line in self.baselines)
        return baseline, None if self.oracle is None else _start_return(self.oracle, num_tasks)

    def score(
        self, returns: Float[np.ndarray, "*batch"], num_tasks: int
    ) -> Float[np.ndarray, "*batch"] | None:
        """Return the normalised score, never clipped; None where it has no meaning.

            score = (return - baseline) / (oracle - baseline)

        Baseline and oracle are means over the first `num_tasks` tasks, those of the returns, at the
        same reward: 0 is the score of learning nothing, 1 that of being given the task.
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
        return replace(
            self,
            lines=tuple(
                line.of_tasks(chosen) for line in self.lines if chosen[: line.num_tasks].any()
            ),
            baselines=tuple(line.of_tasks(chosen) for line in self.baselines),
            oracle=None if self.oracle is None else self.oracle.of_tasks(chosen),
        )

    def of_first(self, number: int) -> "Comparison":
        """Return the comparison over the first so many tasks."""
        return self.of_tasks(np.arange(self.baselines[0].num_tasks) < number)


def _start_return(line: Line, num_tasks: int) -> float:
    return float(line.measure("mean_return")[:, :num_tasks, 0].mean())


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


def write_tidy_table(comparison: Comparison, path: Path) -> None:
    """Write the tidy table as a `.csv` file; a `RunError` says why it cannot be written."""
    rows, text = list(tidy_rows(comparison)), io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_whole(path, text.getvalue().encode())
