"""Methods with a replay: their runs go on bit for bit, on the one device that can hold it."""

from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from learners import test_pearl, test_varibad
from small_runs import create, finish, metrics, outcome, reopened, tensors

from maesn.numerics.mesh import sharing_tasks
from maesn.runs.checkpoint import REPLAY, digest_of_arrays, read_checkpoint, save_checkpoint
from maesn.runs.run import Run

LEARNERS = {
    "rings": test_pearl.tiny(context_reward="sparse"),
    "buffer": test_varibad.small(
        bonus=test_varibad.ALL, trial_episodes=2, observed_reward="sparse"
    ),
}
every_learner = pytest.mark.parametrize(("held", "learner"), LEARNERS.items())


@every_learner
def test_an_interrupted_run_is_the_same_and_its_newest_checkpoint_alone_has_replay(
    held: str, learner: Any, tmp_path: Path
) -> None:
    make = partial(create, learner=learner, iterations=4, checkpoint_every=1)
    whole = finish(make(tmp_path / "whole"))
    resumed = finish(reopened(finish(make(tmp_path / "halves"), iterations=2)))
    assert outcome(whole) == outcome(resumed)
    (first,), (second,) = (run.directory.rglob(f"{REPLAY}*") for run in (whole, resumed))
    assert tensors(first) == tensors(second)
    assert first.name == second.name
    in_replay = ("optimisers/", "replay/") if held == "rings" else ("buffer/",)
    assert not [x for x in tensors(whole.checkpoints()[-1]) if x.startswith(in_replay)]
    assert metrics(whole)[-1]["environment_steps"] == learner.planned_episodes(3, 4) * 40
    assert_what_is_inferred_from_shows_sparse_reward(held, whole)


def assert_what_is_inferred_from_shows_sparse_reward(held: str, run: Run) -> None:
    """Far from the goal it is the same in all tasks but for the cost of control."""
    state = run.latest_state()
    if held == "rings":
        rows = state.replay.rings.rows
        is_row = np.asarray(rows.reward) != 0
        # The critics learn from the dense one.
        assert (np.asarray(rows.reward)[is_row] < -1).mean() > 0.9
        action, shown = np.asarray(rows.action)[is_row], np.asarray(rows.context_reward)[is_row]
    else:
        steps = state.buffer.sample(jax.random.key(0), 10)
        action, shown = np.asarray(steps.action), np.asarray(steps.reward)
    cost = -0.05 * (np.clip(action, -1, 1) ** 2).sum(-1)
    np.testing.assert_allclose(shown, run.env().uninformative_reward + cost, atol=1e-5)


@every_learner
def test_a_run_with_a_replay_of_another_layout_opens_with_an_empty_one(
    held: str, learner: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run = finish(create(tmp_path, learner=learner, iterations=2))
    (file,) = tmp_path.rglob(f"{REPLAY}*")
    save_checkpoint(file, {"older": np.ones(3)}, read_checkpoint(file)[1])
    state = reopened(run).latest_state()
    found, empty = map(learner.replay, (state, run.untrained_state()))
    assert digest_of_arrays(found) == digest_of_arrays(empty)
    assert not caplog.messages  # who adapts needs no replay
    finish(reopened(run), iterations=2)
    assert "The replay of" in caplog.text


def test_moments_in_the_checkpoint_as_they_once_were_are_found(tmp_path: Path) -> None:
    run = finish(create(tmp_path, learner=LEARNERS["rings"], iterations=1))
    whole, path = digest_of_arrays(run.latest_state()), run.checkpoints()[-1]
    (file,) = tmp_path.rglob(f"{REPLAY}*")
    (values, metadata), (replay, _) = read_checkpoint(path), read_checkpoint(file)
    moments = {name: replay.pop(name) for name in [*replay] if name.startswith("optimisers/")}
    assert moments
    save_checkpoint(file, replay, metadata)
    save_checkpoint(path, values | moments, metadata)
    assert reopened(run).latest().is_whole
    assert digest_of_arrays(reopened(run).latest_state()) == whole


@every_learner
def test_several_devices_are_refused(held: str, learner: Any) -> None:
    devices = jax.devices("cpu")
    with sharing_tasks([devices[0]] * 2), pytest.raises(ValueError, match="on one device"):
        learner.check_batch(3)
