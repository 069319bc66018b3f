"""The checkpoints of a run: the latest sound one, and none of another configuration."""

import dataclasses
import logging
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from small_runs import DriftState, create

from maesn.runs.checkpoint import CheckpointError
from maesn.runs.run import Run
from maesn.runs.training import train
from maesn.storage import RunError


def state(iteration: int) -> DriftState:
    return DriftState(jnp.full(3, float(iteration)), jnp.zeros((100, 2)), jnp.asarray(iteration))


def filled(directory: Path, *iterations: int) -> tuple[Run, list[Path]]:
    """A run, and the paths of its checkpoints after these iterations."""
    run = create(directory / "run")
    (run.checkpoints()[0]).unlink()
    return run, [run.save_state(state(n), 100 * n) for n in iterations]


def test_the_latest_checkpoint_is_that_of_the_highest_iteration(tmp_path: Path) -> None:
    run, (first, *_) = filled(tmp_path, 9, 1000000, 20)
    (first.parent / "iteration-2000000.safetensors.partial").touch()
    (first.parent / "iteration-best.safetensors").touch()
    assert [path.stem for path in run.checkpoints()] == [
        "iteration-000009",
        "iteration-000020",
        "iteration-1000000",
    ]
    latest = run.latest()
    assert (latest.iteration, latest.environment_steps) == (1000000, 100000000)
    np.testing.assert_array_equal(latest.state.position, 1e6)


def test_a_damaged_checkpoint_gives_way_to_the_one_before(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run, (first, second, third) = filled(tmp_path, 1, 2, 3)
    third.write_bytes(third.read_bytes()[:-1])
    second.write_bytes(b"")
    with caplog.at_level(logging.WARNING):
        assert run.latest().iteration == 1
    assert first in run.checkpoints()
    assert str(third) in caplog.messages[0]
    assert str(second) in caplog.messages[1]


def test_without_a_sound_checkpoint_there_is_nothing_to_go_on_from(tmp_path: Path) -> None:
    run, (only,) = filled(tmp_path, 1)
    only.write_bytes(b"")
    with pytest.raises(CheckpointError, match="checkpoint"):
        run.latest()


def test_a_checkpoint_belongs_to_the_configuration_of_its_run(tmp_path: Path) -> None:
    run, _ = filled(tmp_path, 1)
    other = dataclasses.replace(run.config, settings=dataclasses.replace(run.settings, seed=5))
    with pytest.raises(RunError, match=r"another `config\.json`"):
        dataclasses.replace(run, config=other).latest()


def numbers(run: Run) -> list[int]:
    return [int(path.stem[-6:]) for path in run.checkpoints()]


@pytest.mark.parametrize(
    ("keep", "wanted"),
    [
        *((None, [0, 10, 11, 12]), (0, [*range(13)]), (1, [0, 12]), (99, [*range(13)])),
        (5, [0, 8, 9, 10, 11, 12]),
    ],
)
def test_how_many_stay_can_be_chosen(tmp_path: Path, keep: int | None, wanted: list[int]) -> None:
    run = create(tmp_path / "run", iterations=12, checkpoint_every=1)
    list(train(run) if keep is None else train(run, keep=keep))
    assert numbers(run) == wanted
    assert [run.load(path).iteration for path in run.checkpoints()] == wanted


def test_the_only_good_checkpoint_is_never_deleted(tmp_path: Path) -> None:
    run, paths = filled(tmp_path, 20, 30, 40, 50)
    for path in paths[2:]:
        path.write_bytes(b"")
    with pytest.raises(CheckpointError):
        run.prune(paths[3], 1)
    assert numbers(run) == [20, 30, 40, 50]
    run.prune(paths[1], 1)  # later ones count for nothing
    assert run.latest().iteration == 30
    run.save_state(state(35))
    run.prune(run.directory / "checkpoints" / "iteration-000035.safetensors", 1)
    assert numbers(run) == [20, 35, 40, 50]
    assert run.latest().iteration == 35
