"""Run directories, as far as figures and tables need them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from maesn.report.adaptation_table import (
    AdaptationTable,
    PriorReach,
    prior_reach,
    read_adaptation,
)
from maesn.report.reading import take_array
from maesn.report.table_name import table_name
from maesn.storage import RunError, read_arrays, read_json, read_json_lines

Positions = Float[np.ndarray, "episode time_plus_1 2"]

_RUN_REMEDY = "give the directory of a run, as `maesn train METHOD --run DIR` makes it"
_METRICS_REMEDY = "train with `maesn train METHOD --run DIR`, or go on with `maesn resume DIR`"
_ADAPT_REMEDY = "write it again with `maesn adapt DIR`"
_EXPLORE_REMEDY = "delete it, and `maesn plot DIR` records it again"


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """One run directory and the settings that it was started with."""

    path: Path
    method: str
    family: str
    variant: str
    seed: int
    settings: Mapping[str, Any]
    """Settings of the run, as in `config.json`."""
    learner: Mapping[str, Any]
    """Settings of the learner, nested as there."""

    def adaptation_files(self) -> list[Path]:
        """Return the tables that `maesn adapt` has left, in the order of their names."""
        files = sorted((self.path / "adaptation").glob("*.csv"))
        return [file for file in files if table_name(file).reward]

    def adaptation(self, tasks: str, reward: str) -> AdaptationTable | None:
        """Return the table of one task set and reward; None if there is none."""
        file = self.path / "adaptation" / f"{tasks}-{reward}.csv"
        if not file.exists():
            return None
        return replace(read_adaptation(file), trial_episodes=self.trial_episodes)

    @property
    def trial_episodes(self) -> int | None:
        """Number of episodes that meta-training has prepared for; None if there is no limit."""
        learner = self.learner.get("learner", self.learner)  # inside of one that is curious
        number = learner.get("trial_episodes")
        return number if isinstance(number, int) else None


def read_run(path: Path) -> RecordedRun:
    """Read a run's `config.json`.

    Raises:
        RunError: if it is missing or lacks a setting.
    """
    file = path / "config.json"
    config = read_json(file, _RUN_REMEDY)
    settings, learner = config.get("settings"), config.get("learner")
    if not isinstance(settings, dict):
        raise RunError(f"Expected `settings` in `{file}`, got none; {_RUN_REMEDY}.")
    for name, kind in {"method": str, "family": str, "variant": str, "seed": int}.items():
        if not isinstance(settings.get(name), kind):
            raise RunError(
                f"Expected `{name}` of type {kind.__name__} among the `settings` in `{file}`, got "
                f"{settings.get(name)!r}; {_RUN_REMEDY}."
            )
    named = {name: settings[name] for name in ("method", "family", "variant", "seed")}
    learner = learner if isinstance(learner, dict) else {}
    return RecordedRun(path=path, settings=settings, learner=learner, **named)


@dataclass(frozen=True)
class LearningCurve:
    """Metrics of one run's meta-training. NaN where a method has no such number."""

    iteration: Float[np.ndarray, " iteration"]
    return_before: Float[np.ndarray, " iteration"]
    """Mean undiscounted return before the inner update."""
    return_after: Float[np.ndarray, " iteration"]
    """The same after it."""
    success_after: Float[np.ndarray, " iteration"]
    """Share of the episodes after the update that reach the goal region."""


def read_learning_curve(path: Path) -> LearningCurve | None:
    """Read a run's `metrics.jsonl`; None if the run has not finished an iteration yet.

    Raises:
        RunError: if a line is broken or has no `iteration`.
    """
    file = path / "metrics.jsonl"
    if not file.exists():
        return None
    lines = read_json_lines(file, _METRICS_REMEDY)
    if not lines:
        return None
    curve = LearningCurve(
        *(
            np.array([_metric(line, name) for line in lines])
            for name in ("iteration", "return_before", "return_after", "success_after")
        )
    )
    if np.isnan(curve.iteration).any() or (np.diff(curve.iteration) <= 0).any():
        raise RunError(
            f"Expected an increasing `iteration` on every line of `{file}`, got otherwise; "
            f"{_METRICS_REMEDY}."
        )
    return curve


def _metric(line: Mapping[str, Any], name: str) -> float:
    value = line.get(name)
    return float(value) if isinstance(value, int | float) else np.nan


@dataclass(frozen=True)
class RecordedExploration:
    """Where episodes go in a world of goals; positions in metres."""

    training_goals: Float[np.ndarray, "row 2"]
    goals: Float[np.ndarray, "task 2"]
    """Of the tasks that the run was adapted to."""
    sparse_radius: float
    """Radius of a goal region."""
    prior_paths: Positions
    """Episodes of the trained policy before any adaptation."""
    untrained_paths: Positions
    """Episodes of a policy that was just initialised."""
    fixed_paths: Positions | None
    """Episodes of the trained policy with one latent; None for methods without latents."""
    prior_latents: Float[np.ndarray, "episode context"] | None
    """The latents drawn in `prior_paths`; None for methods without latents."""
    untrained_success_rate: Float[np.ndarray, " task"]
    """Share of an untrained policy's episodes that reach each goal."""
    solved_at_reset: Float[np.ndarray, " task"]
    """Share of them that start there."""
    episodes_per_task: int
    """Number of those episodes per task."""
    training_landmarks: Float[np.ndarray, "row landmark 2"] | None = None
    """What the training tasks lay out beside their goals; None in a world of goals alone."""
    landmarks: Float[np.ndarray, "task landmark 2"] | None = None
    """The same of the tasks that the run was adapted to."""

    @property
    def untrained_reach(self) -> PriorReach | None:
        """What an untrained policy reaches; None if all tasks are solved at reset."""
        solved = self.solved_at_reset > 0
        return prior_reach(self.untrained_success_rate, solved, self.episodes_per_task)


def exploration_file(path: Path) -> Path:
    """Return where a run keeps its exploration trajectories."""
    return path / "figures" / "exploration.npz"


def read_exploration(path: Path) -> RecordedExploration | None:
    """Read a run's `figures/exploration.npz`; None if there is none.

    Raises:
        RunError: if an array is missing or misshapen.
    """
    file = exploration_file(path)
    if not file.exists():
        return None
    arrays = read_arrays(file, _EXPLORE_REMEDY)

    def take(name: str, *shape: int | str) -> np.ndarray:
        return take_array(arrays, name, shape, file, _EXPLORE_REMEDY)

    def landmarks(name: str, rows: int) -> np.ndarray | None:
        return take(name, rows, "landmark", 2) if name in arrays else None

    has_latents = "fixed_paths" in arrays
    prior = take("prior_paths", "episode", "time", 2)
    training_goals, goals = take("training_goals", "row", 2), take("goals", "task", 2)
    return RecordedExploration(
        training_goals=training_goals,
        goals=goals,
        sparse_radius=float(take("sparse_radius")),
        prior_paths=prior,
        untrained_paths=take("untrained_paths", "episode", "time", 2),
        fixed_paths=take("fixed_paths", "episode", "time", 2) if has_latents else None,
        prior_latents=(
            take("prior_latents", len(prior), "context")
            if has_latents and "prior_latents" in arrays
            else None
        ),
        untrained_success_rate=take("untrained_success_rate", len(goals)),
        solved_at_reset=take("solved_at_reset", len(goals)),
        episodes_per_task=int(take("episodes_per_task")),
        training_landmarks=landmarks("training_landmarks", len(training_goals)),
        landmarks=landmarks("landmarks", len(goals)),
    )


@dataclass(frozen=True)
class Latents:
    """Adapted latent distributions N(mean, exp(log_std)²) of every task."""

    mean: Float[np.ndarray, "update task context"]
    log_std: Float[np.ndarray, "update task context"]
    first_update: int = 0
    """Number of updates that lie before the first entry."""

    @property
    def last_update(self) -> int:
        """Number of updates that lie before the last entry."""
        return self.first_update + int(self.mean.shape[0]) - 1

    @property
    def num_tasks(self) -> int:
        """Number of tasks."""
        return int(self.mean.shape[1])

    @property
    def num_components(self) -> int:
        """Number of components of a latent."""
        return int(self.mean.shape[2])


def read_latents(path: Path, tasks: str, reward: str) -> Latents | None:
    """Read the latents beside an adaptation table; None if the method has none.

    Raises:
        RunError: if an array is missing or misshapen.
    """
    file = path / "adaptation" / f"{tasks}-{reward}.latents.npz"
    if not file.exists():
        return None
    arrays = read_arrays(file, _ADAPT_REMEDY)
    mean = take_array(arrays, "mean", ("update", "task", "dim"), file, _ADAPT_REMEDY)
    log_std = take_array(arrays, "log_std", mean.shape, file, _ADAPT_REMEDY)
    first = take_array(arrays, "first_update", (), file, _ADAPT_REMEDY)
    return Latents(mean, log_std, int(first))
