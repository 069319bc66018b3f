"""Checkpoints: any pytree of arrays as a safetensors file, which can execute nothing.

A tensor is named by its path in the tree, such as `parameters/policy/mlp/layers/0/weight`, and can
be read from NumPy and PyTorch without this library.

Safetensors does not recognise a flipped bit. So the metadata hold a SHA-256 of all else. It is
inside the file and not beside it: one rename then replaces both.
"""

import contextlib
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import safetensors
import safetensors.numpy

from maesn.runtime.archive import refuse_special
from maesn.storage import RunError, explained, write_whole

Tree = TypeVar("Tree")

CHECKSUM = "sha256"


class CheckpointError(RunError):
    """A checkpoint is missing or damaged."""


class MismatchError(RunError):
    """A checkpoint is sound, but belongs to something else."""


class Tensors(NamedTuple):
    """What a checkpoint holds."""

    values: dict[str, np.ndarray]
    metadata: dict[str, str]


class Checkpoint(NamedTuple):
    """A moment between two iterations, which training can go on from."""

    state: Any
    iteration: int  # iterations so far
    environment_steps: int  # control steps that were played so far


def named_leaves(tree: Any) -> dict[str, Any]:
    """Return the leaves of a pytree by their path, as in `policy/mlp/layers/0/bias`."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    named = {jax.tree_util.keystr(path, simple=True, separator="/"): leaf for path, leaf in leaves}
    if len(named) != len(leaves):
        raise ValueError(f"two leaves of the tree have the same path, among {sorted(named)}.")
    return named


def digest_of_arrays(tree: Any) -> str:
    """Return a hexadecimal hash of all names, types, shapes and values of a pytree of arrays."""
    return _checksum(Tensors(_named_arrays(tree), {}))[:16]


def save_checkpoint(path: Path, tree: Any, metadata: Mapping[str, str]) -> None:
    """Write a pytree of arrays; at any moment `path` is the old file, the new one, or none."""
    content = Tensors(_named_arrays(tree), dict(metadata))
    signed = content.metadata | {CHECKSUM: _checksum(content)}
    write_whole(path, safetensors.numpy.save(content.values, metadata=signed))


def read_checkpoint(path: Path) -> Tensors:
    """Read a checkpoint; raises `CheckpointError` if it is missing, unreadable or damaged."""
    try:
        with explained("read", path):
            refuse_special(path)
            with safetensors.safe_open(path, framework="numpy") as file:
                metadata = dict(file.metadata() or {})
                values = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (RunError, ValueError, safetensors.SafetensorError) as error:
        raise CheckpointError(f"`{path}` is no readable checkpoint: {error}") from error
    stated, content = metadata.pop(CHECKSUM, "none"), Tensors(values, metadata)
    if _checksum(content) != stated:
        what = "its content does not have the checksum that it states"
        raise CheckpointError(f"`{path}` is damaged: {what}.")
    return content


def restore(like: Tree, values: Mapping[str, Any], source: Path | str) -> Tree:
    """Return a tree like another one, with values by name; `MismatchError` if they do not fit."""
    expected = named_leaves(like)
    for name in sorted(expected.keys() | values.keys()):
        wanted, found = _describe(expected.get(name)), _describe(values.get(name))
        if wanted != found:
            what = f"tensor `{name}` should be {wanted}, but is {found}"
            raise MismatchError(f"`{source}` does not fit this learner: {what}.")
    leaves = [jnp.asarray(values[name]) for name in expected]
    return jax.tree.unflatten(jax.tree.structure(like), leaves)


def file_name(iteration: int) -> str:
    """Return the name of the checkpoint of an iteration."""
    return f"iteration-{iteration:06d}.safetensors"


def checkpoint_paths(directory: Path) -> list[Path]:
    """Return the paths of all checkpoints, the earliest first."""
    found = directory.glob("iteration-*.safetensors")
    numbered = (path for path in found if path.stem.removeprefix("iteration-").isdecimal())
    return sorted(numbered, key=_number)


def prune(path: Path, keep: int) -> None:
    """Delete the checkpoints before one that is sound, but for those that are worth keeping.

    These are the latest `keep`, this one included, the untrained one, and the first one of each
    power of ten: of iterations 1 to 9, 10 to 99, 100 to 999, ... Nothing is deleted if this one is
    damaged, which is a `CheckpointError`.
    """
    read_checkpoint(path)
    paths = checkpoint_paths(path.parent)
    before = paths[: paths.index(path) + 1]
    first = {len(str(_number(one))) if _number(one) else 0: one for one in reversed(before)}
    for one in set(before[:-keep]) - set(first.values()):
        with contextlib.suppress(OSError):  # a file too many does no harm
            one.unlink()


def _number(path: Path) -> int:
    return int(path.stem.removeprefix("iteration-"))


def _named_arrays(tree: Any) -> dict[str, np.ndarray]:
    """Return the leaves by name, in C order: their bytes are stored as they lie in memory."""
    leaves = named_leaves(jax.device_get(tree))
    return {name: np.asarray(leaf, order="C") for name, leaf in leaves.items()}


def _describe(leaf: Any) -> str:
    return "absent" if leaf is None else f"{np.dtype(leaf.dtype).name}{list(leaf.shape)}"


def _checksum(content: Tensors) -> str:
    # The order of the metadata is lost in the file, hence the sorting.
    metadata, arrays = sorted(content.metadata.items()), sorted(content.values.items())
    described = [[name, _describe(array)] for name, array in arrays]
    sha = hashlib.sha256(json.dumps([metadata, described]).encode())
    for _, array in arrays:
        sha.update(array.tobytes())
    return sha.hexdigest()
