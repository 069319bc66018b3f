"""The files that an adaptation leaves: their names, and reading a table's rows."""

import csv
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from maesn.storage import RunError

# TASKS-REWARD, and behind it what differs from the usual, as in `-then-trpo` or `-on-mjx`.
_NAME = re.compile(r"(?P<tasks>.+)-(?P<reward>dense|sparse)(?P<changed>-.+)?")


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


def latents_file(table: Path) -> Path:
    """Return the path of the adapted latents that belong to a table."""
    return table.with_suffix(".latents.npz")


def record_of_latents(latents: Path) -> Path:
    """Return the path of the file that says how adapted latents were made."""
    return record_file(latents.with_suffix("").with_suffix(".csv"))


def record_file(table: Path) -> Path:
    """Return the path of the file that says how a table was made."""
    return table.with_suffix(".settings.json")


def read_rows(
    path: Path, columns: Iterable[str] = (), remedy: str = "restore it"
) -> list[dict[str, Any]]:
    """Return the rows of a `.csv` file as texts.

    Raises:
        RunError: it cannot be read, or lacks one of the columns; the message ends with the remedy.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            rows, present = list(reader), reader.fieldnames or ()
    except (OSError, UnicodeError, csv.Error) as error:
        raise RunError(f"Expected a table at `{path}`, got {error}; {remedy}.") from error
    for name in columns:
        if name not in present:
            found = ", ".join(present) or "an empty file"
            raise RunError(f"Expected the column `{name}` in `{path}`, got {found}; {remedy}.")
    return rows
