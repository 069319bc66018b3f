"""Run directories, as far as reports need them."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from maesn.storage import RunError, read_arrays, read_json, read_json_lines

# The files of a run directory in which `maesn report` records what it shows.
EXPLORATION = Path("figures") / "exploration.npz"
LATENT_PATHS = Path("figures") / "latent-paths.npz"
SEARCHES = Path("figures") / "searches.npz"
BELIEF = Path("figures") / "belief.npz"
RECORDED_TASKS = "test"  # the task set of all four
REMEDY = "delete it, and report again"

Record = TypeVar("Record")
Positions = Float[np.ndarray, "episode time_plus_1 2"]


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """One run directory and the settings that it was started with, as in `config.json`."""

    path: Path
    method: str
    family: str
    seed: int
    settings: Mapping[str, Any]  # all of the run, and as `learner` those of the learner, nested


def read_run(path: Path) -> RecordedRun:
    """Read a run's `config.json`; a `RunError` says that it is none."""
    remedy = "give the directory of a run, as `maesn train METHOD --run DIR` makes it"
    config = read_json(path / "config.json", remedy)
    try:
        # Without the digest of the weights, in which the seeds of one experiment may differ.
        begun = config.get("provenance", {}).get("init_from", "").rpartition(" ")[0]
        settings = {**config["settings"], "init_from": begun, "learner": config["learner"]}
        method, family, seed = (settings[name] for name in ("method", "family", "seed"))
        return RecordedRun(path, method, family, seed, settings)
    except (KeyError, TypeError) as error:
        raise RunError(f"`{path}` is not of a run ({error!r}): {remedy}.") from error


@dataclass(frozen=True)
class LearningCurve:
    """Mean returns and success around the inner update; NaN where a method has no such number."""

    iteration: Float[np.ndarray, " iteration"]
    return_before: Float[np.ndarray, " iteration"]
    return_after: Float[np.ndarray, " iteration"]
    success_after: Float[np.ndarray, " iteration"]


def read_learning_curve(path: Path) -> LearningCurve | None:
    """Read a run's `metrics.jsonl`; None if the run has not finished an iteration yet."""
    file = path / "metrics.jsonl"
    lines = read_json_lines(file, "go on with `maesn resume DIR`") if file.exists() else []
    columns = (
        [x if isinstance(x := line.get(field.name), int | float) else np.nan for line in lines]
        for field in fields(LearningCurve)
    )
    return LearningCurve(*(np.array(column, float) for column in columns)) if lines else None


@dataclass(frozen=True)
class Latents:
    """Adapted latent distributions N(mean, exp(log_std)²) of every task."""

    mean: Float[np.ndarray, "task update z"]
    log_std: Float[np.ndarray, "task update z"]
    first_update: int  # updates before the first column: 0

    def __post_init__(self) -> None:
        """Refuse arrays that somebody else made."""
        if self.mean.ndim != 3 or not self.mean.size or self.mean.shape != self.log_std.shape:
            raise ValueError("`mean` and `log_std` must be [task, update, z]")


@dataclass(frozen=True)
class RecordedExploration:
    """Paths of episodes in a world of goals; positions in metres."""

    training_goals: Float[np.ndarray, "row 2"]
    goals: Float[np.ndarray, "task 2"]  # goals of the tasks that the run was adapted to
    sparse_radius: float  # radius of a goal region
    prior_paths: Positions  # the trained policy before any adaptation
    untrained_paths: Positions  # a policy that was just initialised
    untrained_success_rate: Float[np.ndarray, " task"]  # share of its episodes that reach each goal
    solved_at_reset: Float[np.ndarray, " task"]  # share of them that start there
    episodes_per_task: int  # number of those episodes per task
    # Episodes with one latent, and the latents of `prior_paths`; None for methods without latents.
    fixed_paths: Positions | None = None
    prior_latents: Float[np.ndarray, "episode z"] | None = None
    # Objects that tasks lay out beside their goals; None in a world of goals alone.
    training_landmarks: Float[np.ndarray, "row landmark 2"] | None = None
    landmarks: Float[np.ndarray, "task landmark 2"] | None = None


def read_recorded(kind: type[Record], file: Path) -> Record | None:
    """Read a record of `maesn report`; None if there is none."""
    return read_record(kind, file, REMEDY) if file.exists() else None


def read_record(kind: type[Record], path: Path, remedy: str) -> Record:
    """Read a dataclass of arrays and numbers from an `.npz` file, in double precision.

    A `RunError`, which ends with the remedy, says that the file cannot be read or is another one.
    """
    arrays = read_arrays(path, remedy)
    try:
        return kind(**{name: x.astype(float) if x.ndim else x.item() for name, x in arrays.items()})
    except (TypeError, ValueError) as error:
        raise RunError(f"`{path}` holds other arrays than it should: {error}; {remedy}.") from error
