"""The files that adaptation leaves: tables of curves, and the latents beside them."""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from maesn.context import AbstractContext, Latent
from maesn.envs import RewardKind
from maesn.evaluation.evaluate import AdaptationOutcome, as_rows
from maesn.report.table_files import latents_file, record_file, table_path
from maesn.storage import (
    RunError,
    explained,
    read_arrays,
    write_arrays,
    write_json,
    write_whole,
)


def adaptation_file(
    directory: Path, tasks: str, reward: RewardKind, first_update: int = 0, suffix: str = ""
) -> Path:
    """Return where a table of adaptation curves goes by default; see `table_path`."""
    return table_path(directory, tasks, reward, first_update=first_update, changed=suffix)


def engine_suffix(engine: str | None) -> str:
    """Return the suffix of a table that an engine has played which was asked for by name.

    Two engines' tables never share a file, and so never a figure.
    """
    return "" if engine is None else f"-on-{engine}"


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows of the same columns, at least one, as a `.csv` file."""
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    _write(path, text.getvalue().encode())


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a `.csv` file that `write_rows` wrote, as texts."""
    with explained("read", path), path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def write_outcome(table: Path, outcome: AdaptationOutcome, record: Mapping[str, Any]) -> None:
    """Write curves as a `.csv` file; beside it adapted latents, and how both were made.

    Args:
        table: path of the curves.
        outcome: what to write.
        record: how it was made, as JSON values.
    """
    # In this order: a record never stands beside curves that it does not belong to.
    with explained("replace", record_file(table)):
        record_file(table).unlink(missing_ok=True)
    write_rows(table, list(as_rows(outcome)))
    write_json(record_file(table), dict(record))
    if isinstance(outcome.contexts, Latent):
        arrays = {
            "mean": outcome.contexts.mean,
            "log_std": outcome.contexts.log_std,
            "first_update": np.asarray(outcome.first_update),
        }
        write_arrays(latents_file(table), arrays)


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
    try:
        arrays = read_arrays(path, "give a file of latents that `maesn adapt` wrote")
        mean, log_std = arrays["mean"], arrays["log_std"]
        first = int(arrays["first_update"])
    except (ValueError, KeyError, TypeError) as error:
        raise RunError(f"`{path}` is not a file of latents that `maesn adapt` wrote.") from error
    if mean.ndim != 3 or not mean.size or mean.shape != log_std.shape:
        raise RunError(f"`{path}` is not a file of latents that `maesn adapt` wrote.")
    if mean[:, -1].shape != like.mean.shape:
        raise RunError(
            f"`{path}` holds latents of the shape [task, z] = {list(mean[:, -1].shape)}, but "
            f"{list(like.mean.shape)} are to be adapted: give the task set and the run of before."
        )
    last = Latent(jnp.asarray(mean[:, -1]), jnp.asarray(log_std[:, -1]))
    return last, first + mean.shape[1] - 1


def _write(path: Path, content: bytes) -> None:
    with explained("write", path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, content)
