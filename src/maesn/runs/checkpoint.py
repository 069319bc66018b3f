"""Checkpoints: any pytree of arrays as a safetensors file.

A tensor is named by its path in the tree, such as `parameters/policy/mlp/layers/0/weight`, and can
be read from NumPy and PyTorch without this library. The format holds numbers and strings alone, so
loading a checkpoint can execute nothing.

Safetensors recognises a file that was cut short, but not a flipped bit. So the metadata hold a
SHA-256 of names, types, shapes, values and the other metadata. It is inside the file and not beside
it: one rename then replaces both, and a copied checkpoint keeps it.
"""

import dataclasses
import hashlib
import json
import logging
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import safetensors
import safetensors.numpy

from maesn.storage import RunError, explained, write_whole

Tree = TypeVar("Tree")

logger = logging.getLogger(__name__)

CHECKSUM = "sha256"


class CheckpointError(RunError):
    """A checkpoint is damaged: cut short, altered, or no checkpoint at all."""


class MismatchError(RunError):
    """A checkpoint is sound, but belongs to something else."""


class Tensors(NamedTuple):
    """What a checkpoint holds."""

    values: dict[str, np.ndarray]
    metadata: dict[str, str]


def named_leaves(tree: Any) -> dict[str, Any]:
    """Return the leaves of a pytree by their path, as in `policy/mlp/layers/0/bias`."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    named = {jax.tree_util.keystr(path, simple=True, separator="/"): leaf for path, leaf in leaves}
    if len(named) != len(leaves):
        raise ValueError(f"two leaves of the tree have the same path, among {sorted(named)}.")
    return named


def digest_of_arrays(tree: Any) -> str:
    """Return a hexadecimal hash of all names, types, shapes and values of a pytree of arrays."""
    leaves = named_leaves(jax.device_get(tree)).items()
    return _checksum(Tensors({name: np.asarray(leaf) for name, leaf in leaves}, {}))[:16]


def save_checkpoint(path: Path, tree: Any, metadata: Mapping[str, str]) -> None:
    """Write a pytree of arrays; at any moment `path` is the old file, the new one, or none.

    Args:
        path: where to.
        tree: arrays only.
        metadata: what the reader should know, as strings.

    Raises:
        RunError: the file cannot be written.
    """
    # "C" order, because the format stores the bytes as they lie in memory.
    values = {
        name: np.asarray(leaf, order="C")
        for name, leaf in named_leaves(jax.device_get(tree)).items()
    }
    content = Tensors(values, dict(metadata))
    signed = content.metadata | {CHECKSUM: _checksum(content)}
    write_whole(path, safetensors.numpy.save(values, metadata=signed))


def read_checkpoint(path: Path) -> Tensors:
    """Read what a checkpoint holds.

    Raises:
        CheckpointError: the file is missing, unreadable or damaged.
    """
    try:
        with explained("read", path), safetensors.safe_open(path, framework="numpy") as file:
            metadata = dict(file.metadata() or {})
            values = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (RunError, safetensors.SafetensorError) as error:
        raise CheckpointError(f"`{path}` is no readable checkpoint: {error}") from error
    stated = metadata.pop(CHECKSUM, "none")
    content = Tensors(values, metadata)
    if _checksum(content) != stated:
        raise CheckpointError(
            f"`{path}` is damaged: its content does not have the checksum that it states."
        )
    return content


def restore(like: Tree, values: Mapping[str, Any], source: Path | str) -> Tree:
    """Return a tree of the structure of `like` with the given values.

    Args:
        like: a freshly initialised tree, or the shapes and types of one.
        values: by the names of `named_leaves`.
        source: where the values come from, for error messages.

    Raises:
        MismatchError: a tensor is missing, left over, or of another shape or type.
    """
    expected = named_leaves(like)
    for name in sorted(expected.keys() | values.keys()):
        _check_fit(name, expected.get(name), values.get(name), source)
    return jax.tree.unflatten(
        jax.tree.structure(like), [jnp.asarray(values[name]) for name in expected]
    )


class Checkpoint(NamedTuple):
    """A moment between two iterations, which training can go on from."""

    state: Any
    iteration: int
    """Iterations so far."""
    environment_steps: int
    """Control steps that were played so far."""


@dataclasses.dataclass(frozen=True)
class CheckpointStore:
    """The checkpoints of one run."""

    directory: Path
    names: Mapping[str, str]
    """What all of them must agree with: kind of thing -> its name or digest."""
    configs: Sequence[str]
    """Digests of the run's configuration, today's first; each checkpoint states one of them."""

    def paths(self) -> list[Path]:
        """Return the paths of all checkpoints, the earliest first."""
        found = self.directory.glob("iteration-*.safetensors")
        numbered = [path for path in found if re.fullmatch(r"iteration-\d+", path.stem)]
        return sorted(numbered, key=lambda path: int(path.stem.removeprefix("iteration-")))

    def save(self, checkpoint: Checkpoint) -> Path:
        """Write a checkpoint and return its path.

        Raises:
            RunError: it cannot be written.
        """
        path = self.directory / f"iteration-{checkpoint.iteration:06d}.safetensors"
        counts = {
            "iteration": str(checkpoint.iteration),
            "environment_steps": str(checkpoint.environment_steps),
        }
        stated = {**self.names, "config": self.configs[0], **counts}
        save_checkpoint(path, checkpoint.state, stated)
        return path

    def load(self, path: Path, like: Any) -> Checkpoint:
        """Read one checkpoint.

        Args:
            path: of the checkpoint.
            like: a state, or the shapes and types of one.

        Raises:
            CheckpointError: it is damaged.
            MismatchError: it belongs to something else.
        """
        values, metadata = read_checkpoint(path)
        for kind, wanted in self.names.items():
            if metadata.get(kind) != wanted:
                raise MismatchError(
                    f"`{path}` is a checkpoint for the {kind} `{metadata.get(kind)}`, but this "
                    f"run's {kind} is `{wanted}`: use it with the run that made it."
                )
        if metadata.get("config") not in self.configs:
            raise MismatchError(
                f"`{path}` was written with another `config.json` than the one of this run: use it "
                "with the run that made it, or restore that file. (`maesn resume RUN --change "
                "NAME=VALUE` changes settings, and keeps earlier checkpoints usable.)"
            )
        state = restore(like, values, path)
        return Checkpoint(state, int(metadata["iteration"]), int(metadata["environment_steps"]))

    def latest(self, like: Any) -> Checkpoint:
        """Read the latest checkpoint that is sound, and say so if a later one is not.

        Args:
            like: a state, or the shapes and types of one.

        Raises:
            CheckpointError: there is no sound one.
            MismatchError: the latest sound one belongs to something else.
        """
        damage: list[str] = []
        for path in reversed(self.paths()):
            try:
                checkpoint = self.load(path, like)
            except CheckpointError as error:
                damage.append(str(error))
                continue
            for sentence in damage:
                logger.warning("%s Using `%s` instead.", sentence, path)
            return checkpoint
        raise CheckpointError(
            " ".join([f"`{self.directory}` holds no sound checkpoint: restore one.", *damage])
        )


def _check_fit(name: str, expected: Any, value: Any, source: Path | str) -> None:
    wanted, found = _describe(expected), _describe(value)
    if wanted != found:
        raise MismatchError(
            f"`{source}` does not fit this learner: tensor `{name}` should be {wanted}, "
            f"but is {found}."
        )


def _describe(leaf: Any) -> str:
    return "absent" if leaf is None else f"{np.dtype(leaf.dtype).name}{list(leaf.shape)}"


def _checksum(content: Tensors) -> str:
    names = sorted(content.values)
    described = [[name, _describe(content.values[name])] for name in names]
    # The order of the metadata is lost in the file, hence the sorting.
    header = json.dumps([sorted(content.metadata.items()), described])
    sha = hashlib.sha256(header.encode())
    for name in names:
        sha.update(content.values[name].tobytes())
    return sha.hexdigest()
