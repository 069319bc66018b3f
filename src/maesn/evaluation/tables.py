"""The files that adaptation leaves: tables of curves, and the latents beside them."""

import csv
import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from maesn.context import AbstractContext, Latent
from maesn.envs import NAMED_SETS
from maesn.evaluation.evaluate import AdaptationCurves, AdaptationOutcome, as_rows
from maesn.evaluation.evaluation import Evaluation
from maesn.report.reading import LATENTS, RECORD, TableName
from maesn.runs.checkpoint import digest_of_arrays
from maesn.storage import (
    RunError,
    explained,
    read_arrays,
    write_arrays,
    write_json,
    write_whole,
)


def adaptation_file(directory: Path, evaluation: Evaluation, first_update: int = 0) -> Path:
    """Return where a table of adaptation curves goes by default.

    `DIR/adaptation/TASKS-REWARD.csv`, where TASKS is the name of a set, or `file-STEM-DIGEST` for a
    user's own file with a digest of the tasks in it. Before it stands `from-UPDATE-` if an earlier
    adaptation goes on. Behind the reward stand rule and wrappers, the number of tasks, the sparse
    radius and the engine, each where it is not the usual one: tables of different kinds never share
    a file, and so never a figure.

    Raises:
        RunError: the file of tasks cannot be read.
    """
    tasks = evaluation.tasks
    name = tasks if tasks in NAMED_SETS else _name_of_file(Path(tasks))
    start = f"from-{first_update}-" if first_update else ""
    parts = {
        f"-first-{evaluation.num_tasks}": evaluation.num_tasks,
        f"-radius-{evaluation.sparse_radius}": evaluation.sparse_radius,
        f"-on-{evaluation.engine}": evaluation.engine,
    }
    changed = evaluation.suffix + "".join(part for part, given in parts.items() if given)
    return TableName(start + name, evaluation.reward, changed).path(directory)


def _name_of_file(path: Path) -> str:
    held = read_arrays(path, "give an .npz file of tasks")
    return f"file-{path.stem}-{digest_of_arrays(held)[:6]}"


def write_rows(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write rows of the same columns, at least one, as a `.csv` file."""
    first, *others = rows
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(first), lineterminator="\n")
    writer.writeheader()
    writer.writerows([first, *others])
    with explained("write", path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, text.getvalue().encode())


class Adapted(NamedTuple):
    """What `maesn.adapt` has done."""

    outcome: AdaptationOutcome
    table: Path
    """The curves, a `.csv` file."""
    latents: Path | None
    """The adapted latents, an `.npz` file, `[task, update, z]`; None where none are adapted."""

    @property
    def curves(self) -> AdaptationCurves:
        """The curves that judge the method, `[task, update]` each."""
        return self.outcome.curves


def write_outcome(table: Path, outcome: AdaptationOutcome, record: Mapping[str, Any]) -> Adapted:
    """Write curves as a `.csv` file; beside it adapted latents, and how both were made.

    Args:
        table: path of the curves.
        outcome: what to write.
        record: how it was made, as JSON values.

    Returns:
        What was written, and where.
    """
    # In this order: a record never stands beside curves that it does not belong to.
    with explained("replace", table.with_suffix(RECORD)):
        table.with_suffix(RECORD).unlink(missing_ok=True)
    write_rows(table, as_rows(outcome))
    write_json(table.with_suffix(RECORD), dict(record))
    if not isinstance(outcome.contexts, Latent):
        return Adapted(outcome, table, None)
    arrays = {
        "mean": outcome.contexts.mean,
        "log_std": outcome.contexts.log_std,
        "first_update": np.asarray(outcome.first_update),
    }
    write_arrays(table.with_suffix(LATENTS), arrays)
    return Adapted(outcome, table, table.with_suffix(LATENTS))


def read_latents(path: Path, like: AbstractContext) -> tuple[Latent, int]:
    """Read the last latents that an adaptation has saved, and the number of updates behind them.

    Args:
        path: of the file.
        like: contexts of the method and the tasks that are to go on from it.

    Raises:
        RunError: the file cannot be read, or belongs to another method or other tasks.
    """
    if not isinstance(like, Latent):
        raise RunError(
            f"`{path}` cannot be a start: this run's method has no latents that are adapted."
        )
    mean, log_std, first = _latents(path)
    if mean[:, -1].shape != like.mean.shape:
        raise RunError(
            f"`{path}` holds latents of the shape [task, z] = {list(mean[:, -1].shape)}, but "
            f"{list(like.mean.shape)} are to be adapted: give the task set and the run of before."
        )
    last = Latent(jnp.asarray(mean[:, -1]), jnp.asarray(log_std[:, -1]))
    return last, first + mean.shape[1] - 1


def adapted_latent(path: Path, task: int) -> tuple[Latent, int]:
    """Read the last latent that an adaptation has saved of one task, and the updates behind it.

    Args:
        path: of the file.
        task: index of the task in the set that was adapted to.

    Raises:
        RunError: the file cannot be read or lacks the task.
    """
    mean, log_std, first = _latents(path)
    num_tasks, columns, _ = mean.shape
    if not 0 <= task < num_tasks:
        raise RunError(
            f"`task` must be an index from 0 to {num_tasks - 1}, the tasks of `{path}`, got {task}."
        )
    last = Latent(jnp.asarray(mean[task, -1]), jnp.asarray(log_std[task, -1]))
    return last, first + columns - 1


def _latents(path: Path) -> tuple[np.ndarray, np.ndarray, int]:
    """Return mean and log standard deviation, `[task, update, z]`, and the first update's number.

    Raises:
        RunError: the file cannot be read or is something else.
    """
    try:
        arrays = read_arrays(path, "give a file of latents that `maesn adapt` wrote")
        mean, log_std = arrays["mean"], arrays["log_std"]
        first = int(arrays["first_update"])
    except (ArithmeticError, ValueError, KeyError, TypeError) as error:
        raise RunError(f"`{path}` is not a file of latents that `maesn adapt` wrote.") from error
    if mean.ndim != 3 or not mean.size or mean.shape != log_std.shape:
        raise RunError(f"`{path}` is not a file of latents that `maesn adapt` wrote.")
    return mean, log_std, first
