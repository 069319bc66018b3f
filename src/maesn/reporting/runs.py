"""Run directories, as far as reports need them."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np
from jaxtyping import Float, jaxtyped

from maesn.storage import RunError, read_arrays, read_json, read_json_lines

# Where a run directory has what `maesn report` has recorded: records of the classes below.
EXPLORATION = Path("figures") / "exploration.npz"
LATENT_PATHS = Path("figures") / "latent-paths.npz"
SEARCHES = Path("figures") / "searches.npz"
RECORDED_TASKS = "test"  # in all three

Record = TypeVar("Record")
Positions = Float[np.ndarray, "episode time_plus_1 2"]

_REMEDY = "give the directory of a run, as `maesn train METHOD --run DIR` makes it"


@dataclass(frozen=True)
class Latents:
    """Adapted latent distributions N(mean, exp(log_std)²) of every task."""

    mean: Float[np.ndarray, "task update z"]
    log_std: Float[np.ndarray, "task update z"]
    first_update: int
    """Number of updates that lie before the first column."""


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """One run directory and the settings that it was started with."""

    path: Path
    method: str
    family: str
    seed: int
    settings: Mapping[str, Any]
    """All settings of the run, as in `config.json`."""
    learner: Mapping[str, Any]
    """Settings of the learner, nested as there."""


def read_run(path: Path) -> RecordedRun:
    """Read a run's `config.json`; a `RunError` says that it is none."""
    file = path / "config.json"
    config = read_json(file, _REMEDY)
    try:
        settings = config["settings"]
        method, family, seed = (settings[name] for name in ("method", "family", "seed"))
        return RecordedRun(path, method, family, seed, settings, config["learner"])
    except (KeyError, TypeError) as error:
        raise RunError(f"`{file}` is not of a run ({error!r}): {_REMEDY}.") from error


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
    """Read a run's `metrics.jsonl`; None if the run has not finished an iteration yet."""
    file = path / "metrics.jsonl"
    lines = read_json_lines(file, "go on with `maesn resume DIR`") if file.exists() else []
    columns = (
        [x if isinstance(x := line.get(field.name), int | float) else np.nan for line in lines]
        for field in fields(LearningCurve)
    )
    return LearningCurve(*(np.array(column, float) for column in columns)) if lines else None


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
    untrained_success_rate: Float[np.ndarray, " task"]
    """Share of an untrained policy's episodes that reach each goal."""
    solved_at_reset: Float[np.ndarray, " task"]
    """Share of them that start there."""
    episodes_per_task: int
    """Number of those episodes per task."""
    fixed_paths: Positions | None = None
    """Episodes of the trained policy with one latent; None for methods without latents."""
    prior_latents: Float[np.ndarray, "episode z"] | None = None
    """The latents drawn in `prior_paths`; None for methods without latents."""
    training_landmarks: Float[np.ndarray, "row landmark 2"] | None = None
    """What the training tasks lay out beside their goals; None in a world of goals alone."""
    landmarks: Float[np.ndarray, "task landmark 2"] | None = None
    """The same of the tasks that the run was adapted to."""


@dataclass(frozen=True)
class LatentPaths:
    """An episode of each of many latents, in one task."""

    latents: Float[np.ndarray, "latent z"]
    paths: Float[np.ndarray, "latent point 2"]
    """Planar positions in metres, thinned out."""


@dataclass(frozen=True)
class RecordedSearches:
    """Latent search in some new tasks, one episode after the other.

    Beliefs are of the part of the return that depends on the latent, over a square of the first two
    components; the others are those of the deployed latent.
    """

    task: Float[np.ndarray, " task"]
    """Indices of the tasks."""
    edge: float
    """The square goes from -edge to edge."""
    played: Float[np.ndarray, "task episode z"]
    returns: Float[np.ndarray, "task episode"]
    reached: Float[np.ndarray, "task episode"]
    """1 where an episode reached the goal."""
    paths: Float[np.ndarray, "task episode point 2"]
    """Planar positions in metres, thinned out."""
    deployed: Float[np.ndarray, "task episode_plus_1 z"]
    """The latent of the highest posterior mean, before each episode and after the last."""
    mean: Float[np.ndarray, "task episode_plus_1 row column"]
    """Posterior mean; rows are the second component."""
    std: Float[np.ndarray, "task episode_plus_1 row column"]
    """Posterior standard deviation."""


def read_recorded(kind: type[Record], file: Path) -> Record | None:
    """Read a record of `maesn report`; None if there is none."""
    return read_record(kind, file) if file.exists() else None


def read_record(
    kind: type[Record], path: Path, remedy: str = "delete it, and report again"
) -> Record:
    """Read a dataclass of arrays and numbers from an `.npz` file, in double precision.

    A field that may be None may be absent or empty. Messages of errors end with the remedy.

    Raises:
        RunError: the file cannot be read, or lacks an array of the shape that its field says.
    """
    arrays, values = read_arrays(path, remedy), dict[str, Any]()
    with jaxtyped("context"):  # an axis of one name has one size in all arrays
        for name, hint in get_type_hints(kind).items():
            array = arrays.get(name, np.zeros(0))
            if type(None) in get_args(hint) and not array.size:
                continue
            values[name] = _double(array, hint)
            if not (array.size and isinstance(values[name], hint)):
                found = f"{array.dtype} {list(array.shape)}"
                raise RunError(f"Expected `{name}` {hint} in `{path}`, got {found}; {remedy}.")
    return kind(**values)


def _double(array: np.ndarray, hint: Any) -> Any:
    """Return an array in double precision, or the number that it holds."""
    if array.dtype.kind not in "fiu":
        return None
    if array.ndim:
        return array.astype(float)
    return float(array) if hint is float else array.item()
