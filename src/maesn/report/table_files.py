"""The names of the files that an adaptation leaves, and what such a name says."""

import re
from pathlib import Path
from typing import NamedTuple

# Names of task sets; anything else is a file.
_TASK_SETS = ("test", "validation", "training", "ood")

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


def table_path(
    directory: Path, tasks: str, reward: str, *, first_update: int = 0, changed: str = ""
) -> Path:
    """Return where the table of an adaptation goes by default.

    `DIR/adaptation/TASKS-REWARD.csv`, where TASKS is the name of a set, or `file-STEM` for a user's
    own file.

    Args:
        directory: of the run.
        tasks: name of a set, or path of a file of tasks.
        reward: "sparse" or "dense".
        first_update: number of updates of the earlier adaptation that this one continues; puts
            `from-UPDATE-` before TASKS.
        changed: what differs from the usual rule, radius or engine, with a hyphen before it; stands
            behind the reward.
    """
    name = tasks if tasks in _TASK_SETS else f"file-{Path(tasks).stem}"
    start = f"from-{first_update}-" if first_update else ""
    return directory / "adaptation" / f"{start}{name}-{reward}{changed}.csv"


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
