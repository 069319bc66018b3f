"""Checkpoints: exact, readable by others, and sound or refused."""

import random
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import safetensors
import safetensors.numpy

from maesn.runs.checkpoint import (
    CheckpointError,
    named_leaves,
    read_checkpoint,
    restore,
    save_checkpoint,
)
from maesn.storage import RunError

TREE = {
    "weight": jnp.arange(6.0).reshape(2, 3),
    "odd": (jnp.asarray([jnp.nan, -0.0, 1e-45, jnp.inf]), jnp.asarray([True, False])),
    "count": jnp.asarray(7),
    "empty": jnp.zeros((0, 2)),
}
METADATA = {"schema": "1", "family": "point"}


def saved(path: Path, tree: Any = TREE) -> Path:
    save_checkpoint(path, tree, METADATA)
    return path


def bits(tree: Any) -> dict[str, tuple[str, tuple[int, ...], bytes]]:
    leaves = {name: np.asarray(leaf) for name, leaf in named_leaves(tree).items()}
    return {name: (str(x.dtype), x.shape, x.tobytes()) for name, x in leaves.items()}


def test_a_tree_comes_back_bit_for_bit_and_others_can_read_it(tmp_path: Path) -> None:
    values, metadata = read_checkpoint(saved(tmp_path / "a"))
    assert metadata == METADATA
    assert bits(restore(jax.eval_shape(lambda: TREE), values, "a")) == bits(TREE)
    by_library = safetensors.numpy.load_file(tmp_path / "a")
    assert bits(by_library) == bits({n: np.asarray(x) for n, x in named_leaves(TREE).items()})


def test_transposed_arrays_are_stored_in_their_own_order(tmp_path: Path) -> None:
    matrix = np.arange(6.0, dtype=np.float32).reshape(2, 3).T
    values, _ = read_checkpoint(saved(tmp_path / "a", {"matrix": matrix}))
    np.testing.assert_array_equal(values["matrix"], matrix)


def test_a_file_of_another_length_is_recognised(tmp_path: Path) -> None:
    path = saved(tmp_path / "a")
    content = path.read_bytes()
    for length in range(len(content)):
        path.write_bytes(content[:length])
        with pytest.raises(CheckpointError):
            read_checkpoint(path)
    path.write_bytes(content + b"\0")
    with pytest.raises(CheckpointError):
        read_checkpoint(path)


def test_any_flipped_bit_is_recognised(tmp_path: Path) -> None:
    path = saved(tmp_path / "a")
    content = path.read_bytes()
    stream = random.Random(0)
    for position in range(len(content)):
        damaged = bytearray(content)
        damaged[position] ^= 1 << stream.randrange(8)
        path.write_bytes(damaged)
        with pytest.raises(CheckpointError):
            read_checkpoint(path)


def test_a_file_that_another_program_wrote_is_recognised(tmp_path: Path) -> None:
    values, _ = read_checkpoint(saved(tmp_path / "a"))
    with safetensors.safe_open(tmp_path / "a", "numpy") as file:
        metadata = file.metadata()
    for changed in (metadata | {"family": "wheeled"}, None):
        safetensors.numpy.save_file(values, tmp_path / "b", changed)
        with pytest.raises(CheckpointError, match="checksum"):
            read_checkpoint(tmp_path / "b")


@pytest.mark.parametrize("name", ["missing", "."])
def test_what_is_no_file_is_recognised(tmp_path: Path, name: str) -> None:
    with pytest.raises(CheckpointError):
        read_checkpoint(tmp_path / name)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"a": None}, r"`a` should be float32\[2\], but is absent"),
        ({"b": jnp.zeros(1)}, r"`b` should be absent, but is float32\[1\]"),
        ({"a": jnp.zeros(3)}, r"`a` should be float32\[2\], but is float32\[3\]"),
        ({"a": jnp.zeros(2, int)}, r"`a` should be float32\[2\], but is int32\[2\]"),
    ],
)
def test_a_misfit_is_refused_by_name(change: dict[str, Any], said: str) -> None:
    values = {
        name: leaf for name, leaf in ({"a": jnp.zeros(2)} | change).items() if leaf is not None
    }
    with pytest.raises(RunError, match=said):
        restore({"a": jnp.ones(2)}, values, "somewhere")
