"""What the name of a table of `maesn adapt` says."""

import re
from pathlib import Path
from typing import NamedTuple

# TASKS-REWARD, and behind it what was changed in the new tasks, as `-10-then-trpo` or `-on-mjx`.
_NAME = re.compile(r"(?P<tasks>.+)-(?P<reward>dense|sparse)(?P<changed>-.+)?")


class TableName(NamedTuple):
    """What the name of a table says."""

    tasks: str
    """Name of the task set, with `from-UPDATE-` before it if an earlier adaptation went on."""
    reward: str
    """Reward of the adaptation; empty if the file is called otherwise."""
    changed: str = ""
    """What was changed about the learner or the engine, with a hyphen before it."""


def table_name(path: Path) -> TableName:
    """Return what the name of a table says."""
    found = _NAME.fullmatch(path.stem)
    return TableName(path.stem, "") if found is None else TableName(*found.groups(default=""))
