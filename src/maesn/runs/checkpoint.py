"""Checkpoints: any pytree of arrays as a safetensors file, which can execute nothing.

A tensor is named by its path in the tree, such as `parameters/policy/mlp/layers/0/weight`, and can
be read from NumPy and PyTorch without this library.

Safetensors does not recognise a flipped bit. So the metadata hold a SHA-256 of all else. It is
inside the file and not beside it: one rename then replaces both.
"""

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
from maesn.storage import RunError, write_whole

Tree = TypeVar("Tree")

CHECKSUM = "sha256"
# Names of checkpoints begin like this, and the name of the replay of the newest one.
ITERATION, REPLAY = "iteration-", "replay-"


class CheckpointError(RunError):
    """A checkpoint is missing or damaged."""


class Checkpoint(NamedTuple):
    """The state between two iterations, from which training can go on."""

    state: Any
    iteration: int  # iterations so far
    environment_steps: int  # control steps that were played so far
    is_whole: bool = True  # False: its replay was not found, and begins empty


def named_leaves(tree: Any) -> dict[str, Any]:
    """Return the leaves of a pytree by their path, as in `policy/mlp/layers/0/bias`."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="/"): leaf for path, leaf in leaves}


def names_of(part: Any, tree: Any) -> set[str]:
    """Return the names of those leaves of a tree that are also leaves of `part`.

    `RunError` says that it has other leaves, which could not be found again.
    """
    held = set(map(id, jax.tree.leaves(part)))
    names = {name for name, leaf in named_leaves(tree).items() if id(leaf) in held}
    if len(names) < len(held):
        raise RunError("`weights` and `replay` of a method must return parts of its state as is.")
    return names


def digest_of_arrays(tree: Any) -> str:
    """Return a hexadecimal hash of all names, types, shapes and values of a pytree of arrays."""
    return _checksum(_named_arrays(tree), {})[:16]


def save_checkpoint(path: Path, tree: Any, metadata: Mapping[str, str]) -> None:
    """Write a pytree of arrays as a whole: a crash leaves the old file, or none."""
    values = _named_arrays(tree)
    signed = {**metadata, CHECKSUM: _checksum(values, metadata)}
    write_whole(path, safetensors.numpy.save(values, metadata=signed))


def read_checkpoint(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Return values by name, and metadata; `CheckpointError` if it is missing or damaged."""
    try:
        refuse_special(path)
        with safetensors.safe_open(path, framework="numpy") as file:
            metadata = dict(file.metadata() or {})
            values = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (OSError, ValueError, safetensors.SafetensorError) as error:
        raise CheckpointError(f"`{path}` is no readable checkpoint: {error}.") from error
    if metadata.pop(CHECKSUM, "none") != _checksum(values, metadata):
        raise CheckpointError(f"`{path}` is damaged: its checksum is another one.")
    return values, metadata


def save_state(path: Path, state: Any, replay: Any, metadata: Mapping[str, str]) -> Path:
    """Write a state as a checkpoint, and beside it its replay, of which only the newest stays.

    The replay is the part that only more training needs, or None; both files get the metadata.
    """
    arrays, file = named_leaves(state), _replay_file(path)
    held = {name: arrays.pop(name) for name in names_of(replay, state)}
    if held:  # first: a checkpoint never lacks it
        save_checkpoint(file, held, metadata)
    save_checkpoint(path, arrays, metadata)
    for old in path.parent.glob(f"{REPLAY}[0-9]*"):
        if old != file:
            old.unlink()
    return path


def replay_beside(path: Path) -> dict[str, np.ndarray]:
    """Return the replay that was written with a checkpoint, by name; none if gone or damaged."""
    try:
        return read_checkpoint(_replay_file(path))[0]
    except CheckpointError:
        return {}


def _replay_file(path: Path) -> Path:
    return path.with_name(path.name.replace(ITERATION, REPLAY))


def restore(like: Tree, values: Mapping[str, Any], source: Path | str) -> Tree:
    """Return a tree like another one, with values by name; `RunError` if they do not fit."""
    expected = named_leaves(like)
    for name in sorted(expected.keys() | values.keys()):
        wanted, found = _describe(expected.get(name)), _describe(values.get(name))
        if wanted != found:
            what = f"tensor `{name}` should be {wanted}, but is {found}"
            raise RunError(f"`{source}` does not fit this learner: {what}.")
    leaves = [jnp.asarray(values[name]) for name in expected]
    return jax.tree.unflatten(jax.tree.structure(like), leaves)


def _named_arrays(tree: Any) -> dict[str, np.ndarray]:
    """Return the leaves by name, in C order: their bytes are stored as they lie in memory."""
    leaves = named_leaves(jax.device_get(tree))
    return {name: np.asarray(leaf, order="C") for name, leaf in leaves.items()}


def _describe(leaf: Any) -> str:
    return "absent" if leaf is None else f"{np.dtype(leaf.dtype).name}{list(leaf.shape)}"


def _checksum(values: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> str:
    # The order of the metadata is lost in the file, hence the sorting.
    arrays = sorted(values.items())
    described = [[name, _describe(array)] for name, array in arrays]
    sha = hashlib.sha256(json.dumps([sorted(metadata.items()), described]).encode())
    for _, array in arrays:
        sha.update(array.tobytes())
    return sha.hexdigest()
