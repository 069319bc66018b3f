"""Finite sets of tasks, and families that make them."""

import hashlib
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Int

from maesn.envs.base import AnyEnv

SetName: TypeAlias = Literal[
    "training", "validation", "test", "ood", "final", "final-2", "ood-validation"
]

NAMED_SETS: tuple[SetName, ...] = get_args(SetName)
"""The place of a name decides the set's random stream."""
OUT_OF_DISTRIBUTION: tuple[SetName, ...] = ("ood", "ood-validation")
"""Tasks of kinds that training never shows; not every family has them."""
SETS = tuple(name for name in NAMED_SETS if name not in OUT_OF_DISTRIBUTION)
"""The sets that every family has, all of one distribution; disjoint unless tasks are few."""
SET_SIZE = 100  # section "Task Setup": 100 distinct meta-training tasks


class TaskSet(eqx.Module):
    """A finite, indexable set of tasks.

    MAESN keeps one latent per training task, so the set is part of what is learned: sampling
    returns indices, and a checkpoint stores the set's `digest`.
    """

    tasks: Any
    """One pytree of arrays with a leading `row` axis."""

    def __len__(self) -> int:
        return int(jax.tree.leaves(self.tasks)[0].shape[0])

    def __getitem__(self, index: int | slice | np.ndarray | Int[Array, " task"]) -> Any:
        """Return one task, or several stacked."""
        return jax.tree.map(lambda leaf: leaf[index], self.tasks)

    def digest(self) -> str:
        """Return a hexadecimal hash of the tasks' values, shapes and structure."""
        leaves, structure = jax.tree.flatten(self.tasks)
        sha = hashlib.sha256(str(structure).encode())
        for leaf in leaves:
            array = np.ascontiguousarray(leaf)
            sha.update(f"{array.dtype.str}{array.shape}".encode())
            sha.update(array.tobytes())
        return sha.hexdigest()[:16]


def accept_all(tasks: Any) -> None:
    """Refuse nothing: every task of the right shape and type has a meaning."""


class TaskFamily(NamedTuple):
    """An environment and its distribution over tasks."""

    name: str
    make_env: Callable[..., AnyEnv]
    """Called with any of `variant`, `reward_kind` and `sparse_radius`; each has a default, which is
    the family's own."""
    draw_tasks: Callable[[np.random.Generator, int], Any]
    """Draws a pytree of that many tasks, stacked."""
    task_names: tuple[str, ...]
    """Names of the arrays in a user's `.npz` file of tasks, in the order of the pytree's leaves."""
    seed: int
    """Fixes the sets of the family."""
    draw_unfamiliar: Mapping[SetName, Callable[[np.random.Generator, int], Any]] = MappingProxyType(
        {}
    )
    """Draw the tasks of the sets `OUT_OF_DISTRIBUTION`, by their names."""
    check_tasks: Callable[[Any], None] = accept_all
    """Raises a `ValueError`, which says what was expected and what came, at tasks that have the
    right shapes and types and yet no meaning, such as an index out of range."""
    num_tasks: int | None = None
    """How many tasks there are, if they are few: every set is then all of them, in the order in
    which `draw_tasks` gives them. None: sets are drawn, and differ."""

    def task_set(self, name: SetName, size: int = SET_SIZE) -> TaskSet:
        """Return one of the family's sets, the same in every process.

        Raises:
            ValueError: the family has no tasks out of distribution, or draws no tasks.
        """
        function = "draw_unfamiliar" if name in OUT_OF_DISTRIBUTION else "draw_tasks"
        draw = self.draw_unfamiliar.get(name) if function != "draw_tasks" else self.draw_tasks
        if draw is None:
            raise ValueError(
                f"family `{self.name}` has the task sets {', '.join(SETS)}, but none called "
                f"`{name}`: give tasks of another kind as an .npz file."
            )
        if self.num_tasks is not None:
            size = min(size, self.num_tasks)
        stream = np.random.default_rng([self.seed, NAMED_SETS.index(name)])
        tasks = draw(stream, size)
        if not _has_rows(tasks, size):
            raise ValueError(
                f"`{function}` of `{self.name}` must return an array of numbers with {size} rows, "
                f"one for each task, or a pytree of such arrays, got {_short(tasks)}."
            )
        return TaskSet(tasks)


def _has_rows(tasks: Any, size: int) -> bool:
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(tasks)]
    kinds = {leaf.dtype.kind for leaf in leaves}
    shapes = {leaf.shape for leaf in leaves}
    return bool(leaves) and kinds <= set("biuf") and all(x[:1] == (size,) for x in shapes)


def _short(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else f"{text[:77]}..."
