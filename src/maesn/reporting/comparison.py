"""Methods adapted to the same tasks: what figures, tables and pages are made from."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from maesn.reporting.published import PublishedCurve
from maesn.reporting.reading import DEPLOY, EXPLORE, AdaptationTable, latents_beside
from maesn.reporting.style import MethodStyle

_JUDGED = {
    EXPLORE: "judged on the episodes that were learned from, z drawn, as in the paper",
    DEPLOY: "judged on fresh episodes of the deployed agent",
}


@dataclass(frozen=True)
class Line:
    """One method, adapted to the same tasks with every seed."""

    name: str  # in names of files
    style: MethodStyle
    seeds: tuple[int, ...]
    table: AdaptationTable  # all seeds: curves are `[seed, task, update]`
    source: str = ""  # the run or method, which lines by other rules share
    weights: tuple[str | None, ...] = ()  # digests of the seeds' weights, where they are known
    training_steps: int | None = None  # environment steps of meta-training; None without any
    settings: Mapping[str, Any] = field(default_factory=dict)  # by their path
    published: PublishedCurve | None = None  # the paper's curve, if it is comparable
    recorded: Path | None = None  # the first seed's exploration, if this file exists
    files: tuple[Path, ...] = ()  # one table for each seed

    @property
    def latents(self) -> Path | None:
        """The file of the first seed's adapted latents, which exists if only a latent adapts."""
        return latents_beside(self.files[0]) if self.files else None

    @property
    def label(self) -> str:
        """The method's name in figures and tables."""
        return self.style.label

    @property
    def protocol(self) -> str:
        """The name of the protocol that it was evaluated by, if any."""
        return str(self.settings.get("evaluation.protocol", ""))

    @property
    def num_tasks(self) -> int:
        """Number of tasks; in a comparison the first ones of all."""
        return self.table.num_tasks

    def has_policies_of(self, other: "Line") -> bool:
        """Whether both are evaluations of the same trained policies, seed by seed."""
        here, there = ((line.source, line.seeds, line.weights) for line in (self, other))
        return bool(self.source) and here == there

    def measure(self, name: str) -> Float[np.ndarray, "seed task update"]:
        """Return one of `MEASURES`."""
        return np.asarray(getattr(self.table, name))

    def column(
        self, index: int, measure: str = "mean_return", num_tasks: int | None = None
    ) -> Float[np.ndarray, "seed task"]:
        """Return one column of a measure, of all tasks or of the first so many."""
        return self.measure(measure)[:, :num_tasks, index]

    def of_tasks(self, chosen: Bool[np.ndarray, " task"]) -> "Line":
        """Return the line over some of the tasks."""
        return replace(self, table=self.table.part(chosen[: self.num_tasks]))

    @property
    def beyond(self) -> str:
        """Say from where on it does what it was never trained for; empty for nowhere."""
        table, first = self.table, self.table.first_beyond
        if first is None:
            return ""
        return (
            f"{self.label} was trained for trials of {table.trial_episodes} episodes: from "
            f"update {table.updates[first]} on it is beyond them"
        )


@dataclass(frozen=True)
class Comparison:
    """Methods on the same tasks, and the references below and above them, if there are any."""

    lines: tuple[Line, ...]
    name: str = ""  # in names of files
    family: str = ""
    sparse_radius: float | None = None  # metres; None where titles do not say it
    horizon: int = 0  # steps of an episode that runs its full time
    baselines: tuple[Line, ...] = ()  # learn nothing; the one of better mean return is the baseline
    oracle: tuple[Line, ...] = ()  # the agent that is given the task, or nobody

    @property
    def tasks(self) -> str:
        """Say which tasks and reward these are."""
        return f"{self.lines[0].table.tasks} tasks, {self.lines[0].table.reward} reward"

    @property
    def title(self) -> str:
        """The title of figures."""
        radius = f", radius {self.sparse_radius:g} m" if self.sparse_radius else ""
        return f"{self.family}, {self.tasks}{radius}"

    @property
    def headline_measures(self) -> tuple[str, ...]:
        """Return, and success where the family defines it."""
        success = self.lines[0].measure("success_rate")
        return ("mean_return", *(() if np.isnan(success).all() else ("success_rate",)))

    @property
    def everyone(self) -> tuple[Line, ...]:
        """The methods, then baselines and oracle."""
        return (*self.lines, *self.baselines, *self.oracle)

    @property
    def is_solved_at_reset(self) -> Bool[np.ndarray, " task"]:
        """Whether some episode of a task starts in its goal region."""
        solved = [line.table.is_solved_at_reset for line in self.baselines or self.lines]
        return np.asarray(np.any(solved, axis=0))

    def references(self, num_tasks: int | None = None) -> dict[str, float]:
        """Return the mean returns of baseline and oracle, if known, in the first so many tasks."""
        count = num_tasks or max(line.num_tasks for line in self.lines)
        groups = {"baseline": self.baselines, "oracle": self.oracle}
        return {
            name: max(float(line.column(0, num_tasks=count).mean()) for line in lines)
            for name, lines in groups.items()
            if lines
        }

    def score(
        self, returns: Float[np.ndarray, "*batch"], num_tasks: int
    ) -> Float[np.ndarray, "*batch"]:
        """Return the score of returns in the first so many tasks; NaN where it has no meaning.

            score = (return - baseline) / (oracle - baseline), never clipped

        with the means of baseline and oracle over the same tasks.
        """
        references = self.references(num_tasks)
        baseline, oracle = (references.get(name, np.nan) for name in ("baseline", "oracle"))
        return (returns - baseline) / (oracle - baseline if oracle > baseline else np.nan)

    def of_tasks(self, chosen: Bool[np.ndarray, " task"]) -> "Comparison":
        """Return the comparison over some of the tasks; methods that have none of them drop out."""
        lines, baselines, oracle = (
            tuple(line.of_tasks(chosen) for line in group if chosen[: line.num_tasks].any())
            for group in (self.lines, self.baselines, self.oracle)
        )
        return replace(self, lines=lines, baselines=baselines, oracle=oracle)

    def parts(self) -> dict[str, "Comparison"]:
        """Return the comparison and, by what their titles add, its parts.

        These are the first tasks, if some methods have no others, and those not solved at reset.
        """
        unsolved, found = ~self.is_solved_at_reset, {"": self}
        fewest = min(line.num_tasks for line in self.lines)
        if fewest < len(unsolved):
            is_first = np.arange(len(unsolved)) < fewest
            found[f", the first {fewest} alone"] = self.of_tasks(is_first)
        if not unsolved.all() and (others := self.of_tasks(unsolved)).lines:
            found[", without tasks solved at reset"] = others
        return found


def note_on_training(lines: Sequence[Line]) -> str:
    """Say so if the tasks are not new: a family may have few, so that each of its sets is all."""
    known = any(line.table.about.get("trained_on") for line in lines)
    return "these tasks are the ones that were trained on" if known else ""


def note_on_judging(lines: Sequence[Line]) -> str:
    """Say which episodes the lines are judged on; with their labels if they differ in it."""
    named: dict[str, list[str]] = {}
    for line in lines:
        by = f", by the protocol `{line.protocol}`" if line.protocol else ""
        named.setdefault(_JUDGED[line.table.purpose] + by, []).append(line.label)
    if len(named) == 1:
        return next(iter(named))
    return "; or ".join(f"{text} ({', '.join(labels)})" for text, labels in named.items())


def tidy_rows(comparison: Comparison) -> Iterator[dict[str, Any]]:
    """Yield one row per method, seed, task and update; a cell is empty if there is no number."""
    solved = comparison.is_solved_at_reset
    for line in comparison.everyone:
        names = ("mean_return", "goal_return", "success_rate")
        numbers = {name: line.measure(name) for name in names}
        numbers["score"] = comparison.score(numbers["mean_return"], line.num_tasks)
        # With the digits of the curves, which are in single precision.
        columns = {name: values.astype(np.float32) for name, values in numbers.items()}
        for seed, task, column in np.ndindex(columns["score"].shape):
            measures = {name: values[seed, task, column] for name, values in columns.items()}
            yield {
                "method": line.name,
                "seed": line.seeds[seed],
                "task": task,
                "update": line.table.updates[column],
                "purpose": line.table.purpose,
                "protocol": line.protocol,
                "steps": line.table.episodes[column] * comparison.horizon,
                **{name: "" if np.isnan(value) else value for name, value in measures.items()},
                "solved_at_reset": int(solved[task]),
            }
