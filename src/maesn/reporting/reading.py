"""The files that an adaptation leaves: their names, tables of curves, and records of arrays."""

import csv
import dataclasses
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar, cast, get_args, get_type_hints

import numpy as np
from jaxtyping import Integer, Real

from maesn.reporting import adaptation_table as table
from maesn.runtime import archive
from maesn.storage import RunError, read_arrays, read_json

Record = TypeVar("Record")

# TASKS-REWARD, and behind it the rule, as in `-then-trpo`, if it is not the method's own.
_NAME = re.compile(r"(?P<tasks>.+)-(?P<reward>dense|sparse)(?P<changed>-.+)?")

# Beside a table, of the same stem: the adapted latents, and how both were made.
LATENTS, RECORD = ".latents.npz", ".settings.json"


class TableName(NamedTuple):
    """What the name of a table says."""

    tasks: str
    """Name of the task set; before it `from-UPDATE-` if an earlier adaptation went on, behind it
    radius, engine and number of tasks where they are not the usual ones."""
    reward: str
    """Reward of the adaptation; empty if the file is called otherwise."""
    changed: str = ""
    """Rule and wrappers, with a hyphen before them; empty for the method as it is."""

    def path(self, directory: Path) -> Path:
        """Return where such a table of a run goes by default."""
        return directory / "adaptation" / f"{self.tasks}-{self.reward}{self.changed}.csv"


def table_name(path: Path) -> TableName:
    """Return what the name of a table says."""
    found = _NAME.fullmatch(path.stem)
    return TableName(path.stem, "") if found is None else TableName(*found.groups(default=""))


def read_rows(
    path: Path, columns: Iterable[str] = (), remedy: str = "restore it"
) -> list[dict[str, Any]]:
    """Return the rows of a `.csv` file as texts; a `RunError` says which column is missing."""
    try:
        archive.refuse_special(path)
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            rows, present = list(reader), reader.fieldnames or ()
    except (OSError, ValueError, csv.Error) as error:
        raise RunError(f"Expected a table at `{path}`, got {error}; {remedy}.") from error
    for name in columns:
        if name not in present:
            found = ", ".join(present) or "an empty file"
            raise RunError(f"Expected the column `{name}` in `{path}`, got {found}; {remedy}.")
    return rows


def read_adaptation(path: Path) -> table.AdaptationTable:
    """Read a table of `maesn adapt`, rows in any order, and its record where there is one.

    A file that is missing, damaged or lacks a row is a `RunError`.
    """
    rows = read_rows(path, table.COLUMNS, remedy(path))
    try:
        columns = {name: _column(name, rows) for name in table.COLUMNS}
        has_deployed = (columns["purpose"] == table.DEPLOY).any()
        purpose = table.DEPLOY if has_deployed else table.EXPLORE
        explored, judged = (_grids(columns, one) for one in (table.EXPLORE, purpose))
        if len(judged["task"]) != len(explored["task"]):
            raise ValueError("the tasks of its two purposes differ")
    except ValueError as error:
        raise RunError(f"`{path}` cannot be drawn: {error}; {remedy(path)}.") from error
    name, (explored_episodes, trial_episodes, rule) = table_name(path), _record(path)
    return table.AdaptationTable(
        tasks=name.tasks,
        reward=name.reward,
        purpose=purpose,
        updates=judged["update"][0].astype(int),
        episodes=judged["episodes"][0].astype(int),
        **{measure: judged[measure] for measure in (*table.MEASURES, "solved_at_reset")},
        explored_success_rate=explored["success_rate"],
        explored_episodes=explored_episodes,
        trial_episodes=trial_episodes,
        rule=rule,
    )


def _record(path: Path) -> tuple[int | None, int | None, str]:
    """Return episodes per update, trial length and rule from the record beside a table, if any."""
    record = path.with_suffix(RECORD)
    found = read_json(record, remedy(path)) if record.exists() else {}
    counts = found.get("episodes_per_update"), found.get("trial_episodes")
    label = found.get("label", "")
    if not (all(isinstance(one, int | None) for one in counts) and isinstance(label, str)):
        raise RunError(f"`{record}` is not what `maesn adapt` writes; {remedy(path)}.")
    return *counts, label


def _column(name: str, rows: Iterable[Mapping[str, str | None]]) -> np.ndarray:
    texts = np.array([row[name] or "nothing" for row in rows])
    if name == "purpose":
        return texts
    numbers = texts.astype(np.float64)
    if not np.isfinite(numbers).all():
        raise ValueError(f"a number in its column `{name}` is not finite, the adaptation failed")
    return numbers


def _grids(columns: Mapping[str, np.ndarray], purpose: str) -> dict[str, table.Curves]:
    """Arrange the numbers of one purpose as `[task, update]`; tasks count from 0."""
    chosen = columns["purpose"] == purpose
    rows = {name: column[chosen] for name, column in columns.items() if name != "purpose"}
    order = np.lexsort((rows["update"], rows["task"]))
    num_tasks, updates = len(np.unique(rows["task"])), np.unique(rows["update"])
    if not len(order) or len(order) != num_tasks * len(updates):
        raise ValueError(f"its rows of purpose {purpose} are no grid of tasks and updates")
    grids = {name: column[order].reshape(num_tasks, -1) for name, column in rows.items()}
    # A deployed agent need not be judged after every update.
    whole = purpose == table.DEPLOY or (np.diff(updates) == 1).all()
    is_grid = (grids["task"] == np.arange(num_tasks)[:, None]).all()
    same = (grids["update"] == updates).all() and np.ptp(grids["episodes"], axis=0).max() == 0
    if not (whole and is_grid and same):
        raise ValueError(f"its rows of purpose {purpose} lack a task or an update, or repeat one")
    return grids


def remedy(path: Path) -> str:
    """Return what to do about a broken file of an adaptation."""
    return f"write `{path.name}` again with `maesn adapt`"


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
    for field in dataclasses.fields(cast(Any, kind)):
        array = arrays.get(field.name)
        has_default = field.default is not dataclasses.MISSING
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
