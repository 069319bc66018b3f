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

from maesn.report import adaptation_table as table
from maesn.runtime import archive
from maesn.storage import RunError, read_arrays, read_json

Record = TypeVar("Record")

# TASKS-REWARD, and behind it what differs from the usual, as in `-then-trpo` or `-on-mjx`.
_NAME = re.compile(r"(?P<tasks>.+)-(?P<reward>dense|sparse)(?P<changed>-.+)?")

# Beside a table, of the same stem: the adapted latents, and how both were made.
LATENTS, RECORD = ".latents.npz", ".settings.json"


class TableName(NamedTuple):
    """What the name of a table says."""

    tasks: str
    """Name of the task set, with `from-UPDATE-` before it if an earlier adaptation went on."""
    reward: str
    """Reward of the adaptation; empty if the file is called otherwise."""
    changed: str = ""
    """What differs from the usual rule, radius or engine, with a hyphen before it."""

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

    A `RunError` says which column, row or number is missing or occurs twice.
    """
    rows = list(enumerate(read_rows(path, table.COLUMNS, remedy(path)), start=2))
    columns = {
        name: np.array([_value(name, row[name], path, line) for line, row in rows])
        for name in table.COLUMNS
    }
    is_deployed = table.DEPLOY in columns["purpose"]
    purpose = table.DEPLOY if is_deployed else table.EXPLORE
    explored, judged = (_grids(columns, one, path) for one in (table.EXPLORE, purpose))
    episodes = judged["episodes"]
    if len(judged["task"]) != len(explored["task"]) or (episodes != episodes[:1]).any():
        what = f"the same `update` and `episodes` for every task and purpose in `{path}`"
        raise _broken(path, what, "different ones")
    name = table_name(path)
    return table.AdaptationTable(
        tasks=name.tasks,
        reward=name.reward,
        purpose=purpose,
        updates=judged["update"][0].astype(int),
        episodes=episodes[0].astype(int),
        **{measure: judged[measure] for measure in (*table.MEASURES, "solved_at_reset")},
        explored_success_rate=explored["success_rate"],
        explored_episodes=_recorded(path, "episodes_per_update"),
        trial_episodes=_recorded(path, "trial_episodes"),
    )


def _recorded(path: Path, name: str) -> int | None:
    """Return a number of the record beside a table; None if there is no record."""
    record = path.with_suffix(RECORD)
    value = read_json(record, remedy(path)).get(name) if record.exists() else None
    if not isinstance(value, int | None):
        raise _broken(path, f"a whole number or null for `{name}` in `{record}`", repr(value))
    return value


def _value(name: str, text: str | None, path: Path, line: int) -> float | str:
    where, found = f"for `{name}` in `{path}`, line {line}", text or "nothing"
    if name == "purpose":
        if found not in table.JUDGED:
            raise _broken(path, f"{' or '.join(table.JUDGED)} {where}", found)
        return found
    try:
        number = float(found)
    except ValueError as error:
        raise _broken(path, f"a number {where}", found) from error
    if not np.isfinite(number):
        raise RunError(
            f"Expected a finite number {where}, got {text}; the adaptation of this task failed, "
            "see what `maesn adapt` reports."
        )
    return number


def _grids(columns: Mapping[str, np.ndarray], purpose: str, path: Path) -> dict[str, table.Curves]:
    """Arrange the numbers of one purpose as `[task, update]`; tasks count from 0."""
    chosen = columns["purpose"] == purpose
    rows = {name: column[chosen] for name, column in columns.items() if name != "purpose"}
    order = np.lexsort((rows["update"], rows["task"]))
    updates, num_tasks = np.unique(rows["update"]), len(np.unique(rows["task"]))
    expected = [np.repeat(np.arange(num_tasks), len(updates)), np.tile(updates, num_tasks)]
    found = [rows["task"][order], rows["update"][order]]
    # A deployed agent need not be judged after every update.
    gaps = purpose == table.EXPLORE and (np.diff(updates) != 1).any()
    if not len(order) or not np.array_equal(found, expected) or gaps:
        what = (
            f"one row of purpose {purpose} for each task and update in `{path}`, tasks 0 to "
            f"{num_tasks - 1} and {len(updates)} updates"
        )
        raise _broken(path, what, f"{len(order)} rows")
    return {name: column[order].reshape(num_tasks, -1) for name, column in rows.items()}


def remedy(path: Path) -> str:
    """Return what to do about a broken file of an adaptation."""
    return f"write `{path.name}` again with `maesn adapt`"


def _broken(path: Path, expected: str, found: object) -> RunError:
    return RunError(f"Expected {expected}, got {found}; {remedy(path)}.")


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
