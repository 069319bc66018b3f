"""Methods adapted to the same tasks: what figures, tables and pages are made from."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from maesn.reporting.published import PublishedCurve
from maesn.reporting.reading import DEPLOY, EXPLORE, AdaptationTable
from maesn.reporting.style import MethodStyle

_JUDGED = {
    EXPLORE: "judged on the episodes that were learned from, z drawn, as in the paper",
    DEPLOY: "judged on fresh episodes of the deployed agent",
}


@dataclass(frozen=True)
class Line:
    """One method, adapted to the same tasks with every seed."""

    name: str
    """For file names."""
    style: MethodStyle
    seeds: tuple[int, ...]
    table: AdaptationTable
    """Of all seeds: curves are `[seed, task, update]`."""
    source: str = ""
    """Name of the run or method, which lines by other rules share."""
    training_steps: int | None = None
    """Environment steps of meta-training; None without any."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Of the run or method, by their path."""
    published: PublishedCurve | None = None
    """What the paper shows for the method; None if that is something else."""
    latents: Path | None = None
    """The adapted latents of the first seed, if only a latent adapts."""

    @property
    def label(self) -> str:
        """How figures and tables call the method."""
        return self.style.label

    @property
    def num_tasks(self) -> int:
        """Number of tasks; in a comparison the first ones of all."""
        return self.table.num_tasks

    def measure(self, name: str) -> Float[np.ndarray, "seed task update"]:
        """Return one of `MEASURES`."""
        return np.asarray(getattr(self.table, name))

    def column(
        self, index: int, measure: str = "mean_return", num_tasks: int | None = None
    ) -> Float[np.ndarray, "seed task"]:
        """Return one column of a measure, of all tasks or of the first so many."""
        return self.measure(measure)[:, :num_tasks, index]

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
    name: str = ""
    """For file names."""
    family: str = ""
    sparse_radius: float | None = None
    """Where titles say it."""
    horizon: int = 0
    """Steps of an episode that runs its full time."""
    baselines: tuple[Line, ...] = ()
    """Agents that learn nothing; the one with the better mean return is the baseline."""
    oracle: tuple[Line, ...] = ()
    """The agent that is given the task, or nobody."""
    recorded: Mapping[str, Path] = field(default_factory=dict)
    """Name of a run -> its recorded exploration."""

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
    def everyone(self) -> tuple[Line, ...]:
        """The methods, then baselines and oracle."""
        return (*self.lines, *self.baselines, *self.oracle)

    @property
    def is_solved_at_reset(self) -> Bool[np.ndarray, " task"]:
        """Which tasks some episode starts in the goal region of."""
        solved = [line.table.is_solved_at_reset for line in self.baselines or self.lines]
        return np.asarray(np.any(solved, axis=0))

    def references(self, num_tasks: int | None = None) -> dict[str, float]:
        """Return the mean returns of baseline and oracle, if known, in the first so many tasks."""
        num_tasks = num_tasks or max(line.num_tasks for line in self.lines)
        groups = {"baseline": self.baselines, "oracle": self.oracle}
        return {
            name: max(float(line.column(0, num_tasks=num_tasks).mean()) for line in lines)
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
        baseline, oracle = references["baseline"], references.get("oracle", np.nan)
        return (returns - baseline) / (oracle - baseline if oracle > baseline else np.nan)

    def of_tasks(self, chosen: Bool[np.ndarray, " task"]) -> "Comparison":
        """Return the comparison over some of the tasks; methods that have none of them drop out."""
        groups: dict[str, Any] = {
            group: tuple(
                replace(line, table=line.table.part(chosen[: line.num_tasks]))
                for line in getattr(self, group)
                if chosen[: line.num_tasks].any()
            )
            for group in ("lines", "baselines", "oracle")
        }
        return replace(self, **groups)

    def parts(self) -> dict[str, "Comparison"]:
        """Return the comparison and, by what their titles add, its parts.

        Where some methods were adapted to the first tasks alone, one part has all methods in these.
        Where some tasks are solved at reset, another one has the methods in the others.
        """
        unsolved, found = ~self.is_solved_at_reset, {"": self}
        fewest = min(line.num_tasks for line in self.lines)
        if fewest < len(unsolved):
            is_first = np.arange(len(unsolved)) < fewest
            found[f", the first {fewest} alone"] = self.of_tasks(is_first)
        others = self.of_tasks(unsolved)
        if others.lines and not unsolved.all():
            found[", without tasks solved at reset"] = others
        return found


def by_line(texts: Mapping[str, str]) -> str:
    """Join what is said of lines by their label: each text once, with names if texts differ."""
    named = {text: [name for name in texts if texts[name] == text] for text in texts.values()}
    if len(named) == 1:
        return next(iter(named))
    return "; or ".join(f"{text} ({', '.join(names)})" for text, names in named.items())


def note_on_judging(lines: Sequence[Line]) -> str:
    """Say which episodes the lines are judged on."""
    return by_line({line.label: _JUDGED[line.table.purpose] for line in lines})


def tidy_rows(comparison: Comparison) -> Iterator[dict[str, Any]]:
    """Yield one row per method, seed, task and update; `score` is empty if there is none.

    Measures are in the single precision of the curves, so that they are written with its digits.
    """
    solved = comparison.is_solved_at_reset
    for line in comparison.everyone:
        names = ("mean_return", "goal_return", "success_rate")
        measures = {name: line.measure(name).astype(np.float32) for name in names}
        scores = comparison.score(line.measure("mean_return"), line.num_tasks).astype(np.float32)
        for seed, task, column in np.ndindex(scores.shape):
            score = scores[seed, task, column]
            yield {
                "method": line.name,
                "seed": line.seeds[seed],
                "task": task,
                "update": line.table.updates[column],
                "purpose": line.table.purpose,
                "steps": line.table.episodes[column] * comparison.horizon,
                **{name: values[seed, task, column] for name, values in measures.items()},
                "score": "" if np.isnan(score) else score,
                "solved_at_reset": int(solved[task]),
            }
