"""Finding runs, and the methods, families and tasks that they were made with.

A policy that comes with the library is a run directory of its last checkpoint alone.
"""

import contextlib
import os
import shutil
from pathlib import Path
from typing import Any

from maesn.envs import NAMED_SETS, TaskFamily, TaskSet, find_family
from maesn.envs.sources import find_tasks, imported, load_tasks, resolve_family
from maesn.learners import AbstractMetaLearner
from maesn.runtime.archive import PARTIAL
from maesn.storage import RunError, explained, refusals

TASKS_FILE = "tasks.npz"  # in a run directory, if the tasks are a user's own
TRAINED = Path(__file__).resolve().parents[1] / "trained"


def own_method(name: str) -> AbstractMetaLearner[Any, Any]:
    """Import a meta-learner of a user's own: a value, or a class or function that makes one.

    `RunError` says that `module:name` cannot be imported, or is something else.
    """
    found = imported(name, "method")
    if callable(found) and not isinstance(found, AbstractMetaLearner):
        with refusals(f"`{name}` cannot be called without arguments: "):
            try:
                found = found()
            except TypeError as error:
                raise ValueError(f"{error}.") from error
    if not isinstance(found, AbstractMetaLearner):
        raise RunError(
            f"`{name}` must be a `maesn.AbstractMetaLearner`, or what makes one, got "
            f"{type(found).__name__}."
        )
    return found


def recorded_family(recorded: str, given: str | TaskFamily | None) -> TaskFamily:
    """Return the family of a run: the library's of that name, or the user's that is given."""
    if given is None:
        with refusals("give the run's family as `module:name` (--family on the command line): "):
            return find_family(recorded)
    family = resolve_family(given) if isinstance(given, str) else given
    if family.name != recorded:
        raise RunError(f"the run's family is `{recorded}`, but `{family.name}` was given.")
    return family


def recorded_tasks(directory: Path, name: str, digest: str, family: TaskFamily) -> TaskSet:
    """Return what a run was trained on; refuse tasks that have become others since."""
    file = directory / TASKS_FILE
    tasks = find_tasks(name, family) if name in NAMED_SETS else load_tasks(file, family)
    if tasks.digest() != digest:
        raise RunError(
            f"`{directory}` was trained on other tasks than `{name}` of the family `{family.name}` "
            "now holds: restore what it was made with."
        )
    return tasks


def policy_names() -> list[str]:
    """Return the names of the policies that come with the library."""
    return sorted(path.name for path in TRAINED.iterdir() if path.is_dir())


def find_run(run: str | Path) -> Path:
    """Return the directory of a run, or of the policy of this name if there is no such path.

    Of a policy it is the copy in the current folder, once `working_copy` has made that.
    """
    if Path(run).exists():
        return Path(run)
    if str(run) in policy_names():
        copy = _copy_of(TRAINED / run)
        return copy if (copy / "config.json").exists() else TRAINED / run
    raise RunError(
        f"there is no run in `{run}`: name a directory that `maesn train` has made, or a policy "
        f"that comes with the library: {', '.join(policy_names())}."
    )


def _copy_of(policy: Path) -> Path:
    return Path(f"maesn-{policy.name}")


def working_copy(run: str | Path) -> Path:
    """Return the directory of a run that may be written to.

    Of the policy `NAME` that comes with the library it is a copy, `maesn-NAME` in the current
    folder, made when it is first asked for.
    """
    source = find_run(run)
    if source.resolve().parent != TRAINED.resolve():
        return source
    copy = _copy_of(source)
    if not copy.exists():
        partial = Path(f"{copy}.{os.getpid()}{PARTIAL}")
        with explained("make", copy):
            shutil.copytree(source, partial)
            with contextlib.suppress(OSError):  # another process was faster
                partial.rename(copy)
            shutil.rmtree(partial, ignore_errors=True)
    return copy
