"""Checkpoints: exact, readable by others, and sound or refused."""

import errno
import json
import os
import pickle
import random
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import safetensors.numpy
from small_runs import tiny_maesn

from maesn.learners import Problem
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


def parsed(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """The file as the format's specification says, without its library."""
    content = path.read_bytes()
    length = int.from_bytes(content[:8], "little")
    header, data = json.loads(content[8 : 8 + length]), content[8 + length :]
    metadata = header.pop("__metadata__")
    types = {"F32": np.float32, "I32": np.int32, "BOOL": np.bool_}
    values = {
        name: np.frombuffer(data[slice(*entry["data_offsets"])], types[entry["dtype"]]).reshape(
            entry["shape"]
        )
        for name, entry in header.items()
    }
    return values, metadata


def test_a_tree_comes_back_bit_for_bit(tmp_path: Path) -> None:
    values, metadata = read_checkpoint(saved(tmp_path / "a"))
    assert metadata == METADATA
    assert bits(restore(jax.eval_shape(lambda: TREE), values, "a")) == bits(TREE)


def test_others_can_read_it(tmp_path: Path) -> None:
    path = saved(tmp_path / "a")
    by_hand, metadata = parsed(path)
    by_library = safetensors.numpy.load_file(path)
    wanted = {name: np.asarray(leaf) for name, leaf in named_leaves(TREE).items()}
    assert bits(by_hand) == bits(by_library) == bits(wanted)
    assert metadata.items() > METADATA.items()


def test_tensors_are_named_by_their_path(tmp_path: Path) -> None:
    state = jax.eval_shape(lambda key: tiny_maesn().init(key, Problem(2, 2, 5)), jax.random.key(0))
    assert {name: leaf.shape for name, leaf in named_leaves(state).items()} == {
        "iteration": (),
        "parameters/context_table/log_std": (5, 2),
        "parameters/context_table/mean": (5, 2),
        "parameters/policy/log_std": (2,),
        "parameters/policy/mlp/layers/0/bias": (8,),
        "parameters/policy/mlp/layers/0/weight": (4, 8),
        "parameters/policy/mlp/layers/1/bias": (2,),
        "parameters/policy/mlp/layers/1/weight": (8, 2),
        "parameters/step_sizes/context/log_std": (2,),
        "parameters/step_sizes/context/mean": (2,),
    }


def test_transposed_arrays_are_stored_in_their_own_order(tmp_path: Path) -> None:
    matrix = np.arange(6.0, dtype=np.float32).reshape(2, 3).T
    values, _ = read_checkpoint(saved(tmp_path / "a", {"matrix": matrix}))
    np.testing.assert_array_equal(values["matrix"], matrix)


def test_a_file_cut_short_anywhere_is_recognised(tmp_path: Path) -> None:
    path = saved(tmp_path / "a")
    content = path.read_bytes()
    for length in range(len(content)):
        path.write_bytes(content[:length])
        with pytest.raises(CheckpointError, match="no readable checkpoint"):
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


def test_a_longer_file_is_recognised(tmp_path: Path) -> None:
    path = saved(tmp_path / "a")
    path.write_bytes(path.read_bytes() + b"\0")
    with pytest.raises(CheckpointError):
        read_checkpoint(path)


def test_changed_metadata_are_recognised(tmp_path: Path) -> None:
    values, metadata = parsed(saved(tmp_path / "a"))
    safetensors.numpy.save_file(values, tmp_path / "b", metadata | {"family": "wheeled"})
    with pytest.raises(CheckpointError, match="checksum"):
        read_checkpoint(tmp_path / "b")


def test_a_file_of_other_tensors_is_recognised(tmp_path: Path) -> None:
    safetensors.numpy.save_file({"x": np.zeros(3)}, tmp_path / "foreign")
    with pytest.raises(CheckpointError, match="checksum"):
        read_checkpoint(tmp_path / "foreign")


@pytest.mark.parametrize("name", ["missing", "."])
def test_what_is_no_file_is_recognised(tmp_path: Path, name: str) -> None:
    with pytest.raises(CheckpointError, match="no readable checkpoint"):
        read_checkpoint(tmp_path / name)


def test_loading_executes_nothing(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> Any:
            return Path.touch, (tmp_path / "sprung",)

    path = tmp_path / "a"
    path.write_bytes(pickle.dumps(Trap()))
    with pytest.raises(CheckpointError):
        read_checkpoint(path)
    assert not (tmp_path / "sprung").exists()
    pickle.loads(path.read_bytes())  # the trap works
    assert (tmp_path / "sprung").exists()


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


class Crash(BaseException):
    """The process is gone."""


@pytest.mark.parametrize("call", ["os.fsync", "pathlib.Path.replace", "pathlib.Path.open"])
@pytest.mark.parametrize("failure", [OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), Crash()])
def test_a_failed_write_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str, failure: BaseException
) -> None:
    path = saved(tmp_path / "a")
    before = path.read_bytes()

    def fail(*_: Any, **__: Any) -> None:
        raise failure

    with monkeypatch.context() as patch:
        patch.setattr(call, fail)
        with pytest.raises((RunError, Crash)) as caught:
            saved(path, {"x": jnp.zeros(100)})
    if isinstance(failure, OSError):
        assert str(caught.value) == (
            f"cannot write `{path}` (No space left on device): mend that, or choose another path."
        )
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
