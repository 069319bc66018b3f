"""Families and tasks by name, and those of a user: from a module, from a file."""

import importlib
import warnings
from pathlib import Path
from typing import Any

import jax
import numpy as np

from maesn.envs.catalogue import find_family, is_own, split_variant
from maesn.envs.tasks import NAMED_SETS, TaskFamily, TaskSet
from maesn.storage import RunError, read_arrays, refusals, write_arrays

# Bytes of a user's tasks: two million goals. Training takes about a hundred times as much memory.
LARGEST_TASKS = 2**24


def resolve_family(name: str) -> TaskFamily:
    """Return a family by its name, or as `imported`."""
    if not is_own(name):
        try:
            return find_family(name)
        except ValueError as error:
            raise RunError(f"{error} Give your own as `module:name`.") from error
    known, variant = split_variant(name)
    if variant and variant in find_family(known).make_env().variants:  # a study's name for both
        raise RunError(f"`family` must be `{known}` here, with `{variant}` as its `variant`.")
    family = imported(name, "family")
    if not isinstance(family, TaskFamily):
        raise RunError(f"`{name}` must be a TaskFamily, got {type(family).__name__}.")
    return family


def imported(name: str, option: str) -> Any:
    """Import a user's own `module:name`, as an option says. Never call this with a file's words."""
    module, _, attribute = name.partition(":")
    try:
        return getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise RunError(
            f"`{option}` is `{name}`, but {error}: `module` must be importable (set PYTHONPATH to "
            "where it is) and have that name in it."
        ) from error


def find_tasks(name: str | Path, family: TaskFamily) -> TaskSet:
    """Return a set of the family by its name, or a user's own by the path of its `.npz` file."""
    for set_name in NAMED_SETS:
        if name == set_name:
            with refusals(f"`tasks` cannot be `{name}`: "):
                return family.task_set(set_name)
    if not Path(name).exists():
        raise RunError(
            f"`tasks` must be one of {', '.join(NAMED_SETS)} or the path of an .npz file, got "
            f"`{name}`, which is neither: check the spelling."
        )
    return load_tasks(name, family)


def load_tasks(path: str | Path, family: TaskFamily) -> TaskSet:
    """Read tasks of a family from an `.npz` file with the arrays `family.task_names`.

    Each has one row per task, such as the `goal` of `wheeled` and `point`, `[row, 2]` in metres.
    """
    names = family.task_names
    wanted = f"the arrays {', '.join(names)}, one row for each task"
    remedy = f"give an .npz file with {wanted}, as numpy.savez writes it"
    held = read_arrays(Path(path), remedy, LARGEST_TASKS)
    if not set(names) <= set(held):
        raise RunError(f"`{path}` must hold {wanted}; it holds {', '.join(held) or 'none'}.")
    drawn, structure = jax.tree.flatten(family.draw_tasks(np.random.default_rng(0), 1))
    if len(names) != len(drawn):
        raise RunError(
            f"`task_names` of the family `{family.name}` must name each array of its tasks: they "
            f"are {len(drawn)} arrays, but the names are {', '.join(names)}."
        )
    tasks = [
        _fitted(held[name], np.asarray(like), f"array `{name}` of `{path}`")
        for name, like in zip(names, drawn, strict=True)
    ]
    rows = sorted({len(array) for array in tasks})
    if len(rows) != 1 or 0 in rows:
        raise RunError(
            f"the arrays of `{path}` must all have one row for each task, and at least one; "
            f"they have {', '.join(map(str, rows))} rows."
        )
    found = TaskSet(jax.tree.unflatten(structure, tasks))
    with refusals(f"the tasks of `{path}` cannot be used: "):
        family.check_tasks(found.tasks)
    return found


def save_tasks(path: Path, tasks: TaskSet, family: TaskFamily) -> None:
    """Write tasks as `load_tasks` reads them."""
    leaves = map(np.asarray, jax.tree.leaves(tasks.tasks))
    write_arrays(path, dict(zip(family.task_names, leaves, strict=True)))


def _fitted(array: np.ndarray, like: np.ndarray, what: str) -> np.ndarray:
    """Return an array as the family's own type; but for its rows it must have that shape."""
    if array.ndim != like.ndim or array.shape[1:] != like.shape[1:]:
        wanted = ", ".join(["tasks", *map(str, like.shape[1:])])
        raise RunError(f"{what} must have the shape [{wanted}], got {list(array.shape)}.")
    kinds = "b" if like.dtype.kind == "b" else "fiu"
    if array.dtype.kind not in kinds or not np.can_cast(array.dtype, like.dtype, "same_kind"):
        raise RunError(f"{what} must hold values of type {like.dtype}, got {array.dtype}.")
    with np.errstate(over="ignore"):  # what overflows is refused in the next line
        fitted = array.astype(like.dtype)
    wrong = ~(np.isfinite(fitted) & np.isclose(fitted, array))
    if wrong.any():
        row = int(np.argwhere(wrong)[0][0])
        raise RunError(
            f"{what} must hold finite numbers that fit into {like.dtype}, got {array[row]} in row "
            f"{row}."
        )
    return fitted


def warn_of_known_tests(family: TaskFamily, tasks: TaskSet) -> None:
    """Say so if the test tasks are those of training, as where `draw_tasks` ignores its stream."""
    if family.task_set("test").digest() != tasks.digest():
        return
    why = "`draw_tasks` draws the same whatever its stream"
    if family.num_tasks is not None:
        why = f"there are {family.num_tasks} tasks, and every set is all of them"
    warnings.warn(
        f"the test tasks of `{family.name}` are those that are trained on: {why}, so a result on "
        "them says nothing of new tasks.",
        stacklevel=3,
    )
