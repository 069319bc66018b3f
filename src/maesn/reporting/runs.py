"""Run directories, as far as figures and tables need them."""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, cast, get_args, get_type_hints

import numpy as np
from jaxtyping import Float, Integer, Real

from maesn.reporting import reading
from maesn.reporting.reading import AdaptationTable, TableName
from maesn.storage import RunError, read_arrays, read_json, read_json_lines

# Where a run directory has what `maesn report` has recorded: records of the classes below.
EXPLORATION = Path("figures") / "exploration.npz"
LATENT_PATHS = Path("figures") / "latent-paths.npz"
SEARCHES = Path("figures") / "searches.npz"
RECORDED_TASKS = "test"  # in all three

Record = TypeVar("Record")
Positions = Float[np.ndarray, "episode time_plus_1 2"]

_RUN_REMEDY = "give the directory of a run, as `maesn train METHOD --run DIR` makes it"
_METRICS_REMEDY = "train with `maesn train METHOD --run DIR`, or go on with `maesn resume DIR`"
_RECORD_REMEDY = "delete it, and `maesn report DIR` records it again"


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
    settings: Mapping[str, Any]
    """Settings of the run, as in `config.json`."""
    learner: Mapping[str, Any]
    """Settings of the learner, nested as there."""

    @property
    def method(self) -> str:
        """The preset that the run trained."""
        return str(self.settings["method"])

    @property
    def family(self) -> str:
        """Name of the task family."""
        return str(self.settings["family"])

    @property
    def seed(self) -> int:
        """Seed of the run."""
        return int(self.settings["seed"])

    def tables(self) -> dict[TableName, Path]:
        """Return the tables that `maesn adapt` has left, by what their names say."""
        files = sorted((self.path / "adaptation").glob("*.csv"))
        return {name: file for file in files if (name := reading.table_name(file)).reward}

    def adaptation(self, tasks: str, reward: str) -> AdaptationTable | None:
        """Return the usual adaptation to a task set with a reward; None if there is none."""
        file = TableName(tasks, reward).path(self.path)
        return reading.read_adaptation(file) if file.exists() else None

    def latents(self, tasks: str, reward: str) -> Latents | None:
        """Return the latents of the same adaptation; None if there are none."""
        table = TableName(tasks, reward).path(self.path)
        file = table.with_suffix(reading.LATENTS)
        if not file.exists():
            return None
        adapted = reading.read_adaptation(table)
        sizes = {"task": adapted.num_tasks, "update": len(adapted.updates)}
        return read_record(Latents, file, reading.remedy(table), sizes)


def read_run(path: Path) -> RecordedRun:
    """Read a run's `config.json`; a `RunError` says what is missing."""
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
    return RecordedRun(path, settings, learner if isinstance(learner, dict) else {})


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
    lines = read_json_lines(file, _METRICS_REMEDY) if file.exists() else []
    if not lines:
        return None
    columns = (
        [x if isinstance(x := line.get(field.name), int | float) else np.nan for line in lines]
        for field in fields(LearningCurve)
    )
    curve = LearningCurve(*(np.array(column, float) for column in columns))
    if np.isnan(curve.iteration).any() or (np.diff(curve.iteration) <= 0).any():
        raise RunError(
            f"Expected an increasing `iteration` on every line of `{file}`, got otherwise; "
            f"{_METRICS_REMEDY}."
        )
    return curve


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
    return read_record(kind, file, _RECORD_REMEDY) if file.exists() else None


def read_record(
    kind: type[Record], path: Path, remedy: str, sizes: Mapping[str, int] = MappingProxyType({})
) -> Record:
    """Read a dataclass of arrays and numbers from an `.npz` file, in double precision.

    The annotations of the fields are the shapes that the arrays must have; an axis of one name has
    one size in all of them, that of `sizes` where it is there. A field with a default may be absent
    or empty. Messages of errors end with the remedy.

    Raises:
        RunError: an array is absent, not numeric, empty or of another shape.
    """
    arrays, known = read_arrays(path, remedy), dict(sizes)
    hints, values = get_type_hints(kind), {}
    for field in fields(cast(Any, kind)):
        array = arrays.get(field.name)
        has_default = field.default is not MISSING
        if has_default and (array is None or not array.size):
            continue
        hint = next(iter(get_args(hints[field.name])), hints[field.name])
        axes = getattr(hint, "dim_str", "").split()
        wanted = [str(known.get(axis, axis)) for axis in axes]
        numbers = Integer if hint is int else Real
        shape: Any = numbers[np.ndarray, " ".join(wanted)]
        if array is None or not isinstance(array, shape) or not array.size:
            found = ", ".join(sorted(arrays)) or "no arrays"
            if array is not None:
                found = f"{array.dtype} {list(array.shape)}"
            expected = f"`{field.name}` [{', '.join(wanted)}] in `{path}`"
            raise RunError(f"Expected {expected}, got {found}; {remedy}.")
        known |= zip(axes, array.shape, strict=True)
        values[field.name] = array.astype(np.float64) if axes else hint(array)
    return kind(**values)
