"""The checkpoints of a run: the latest sound one, and none of another run."""

import logging
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from maesn.runs.checkpoint import Checkpoint, CheckpointError, CheckpointStore, MismatchError

STORE_LIKE = {"x": jnp.zeros(3)}


def store(directory: Path, *configs: str, **names: str) -> CheckpointStore:
    return CheckpointStore(
        directory, {"family": "point", "method": "maesn"} | names, configs or ("now", "before")
    )


def fill(directory: Path, *iterations: int) -> list[Path]:
    return [
        store(directory).save(Checkpoint({"x": jnp.full(3, float(n))}, n, 100 * n))
        for n in iterations
    ]


def test_the_latest_checkpoint_is_that_of_the_highest_iteration(tmp_path: Path) -> None:
    fill(tmp_path, 9, 1000000, 20)
    (tmp_path / "iteration-2000000.safetensors.partial").touch()
    (tmp_path / "iteration-best.safetensors").touch()
    assert [path.stem for path in store(tmp_path).paths()] == [
        "iteration-000009",
        "iteration-000020",
        "iteration-1000000",
    ]
    state, iteration, steps = store(tmp_path).latest(STORE_LIKE)
    assert (iteration, steps) == (1000000, 100000000)
    np.testing.assert_array_equal(state["x"], 1e6)


def test_a_damaged_checkpoint_gives_way_to_the_one_before(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    first, second, third = fill(tmp_path, 1, 2, 3)
    third.write_bytes(third.read_bytes()[:-1])
    second.write_bytes(b"")
    with caplog.at_level(logging.WARNING):
        assert store(tmp_path).latest(STORE_LIKE).iteration == 1
    assert [record.getMessage().count(str(first)) for record in caplog.records] == [1, 1]
    assert str(third) in caplog.messages[0]
    assert str(second) in caplog.messages[1]


def test_without_a_sound_checkpoint_there_is_nothing_to_go_on_from(tmp_path: Path) -> None:
    (only,) = fill(tmp_path, 1)
    only.write_bytes(b"")
    with pytest.raises(CheckpointError, match=r"no sound checkpoint.*no readable checkpoint"):
        store(tmp_path).latest(STORE_LIKE)


@pytest.mark.parametrize("kind", ["family", "method"])
def test_a_checkpoint_of_something_else_is_refused_by_name(tmp_path: Path, kind: str) -> None:
    fill(tmp_path, 1, 2)
    with pytest.raises(MismatchError, match=f"for the {kind} `(point|maesn)`.*{kind} is `other`"):
        store(tmp_path, **{kind: "other"}).latest(STORE_LIKE)


def test_a_checkpoint_belongs_to_one_of_the_runs_configurations(tmp_path: Path) -> None:
    fill(tmp_path, 1)
    assert store(tmp_path, "later", "now", "before").latest(STORE_LIKE).iteration == 1
    with pytest.raises(MismatchError, match=r"with another `config.json`.*--change NAME=VALUE"):
        store(tmp_path, "later", "before").latest(STORE_LIKE)
