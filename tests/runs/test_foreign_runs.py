"""Runs in foreign environments: resumed, interrupted and failing ones."""

from functools import partial
from pathlib import Path
from typing import Any

import pytest
from small_runs import finish, metrics, tensors, tiny_maesn, tiny_settings
from strangers import HORIZON, draw_walks, make_fragile, make_walker
from synthetic_runs import learning_curve, write_metrics

from maesn import rl2
from maesn.api import adapt, report
from maesn.envs import TaskFamily
from maesn.envs.foreign import gymnasium_family
from maesn.policies import Recurrent
from maesn.runs.run import Run
from maesn.runs.training import train
from maesn.storage import RunError
from maesn.worlds import EpisodeError


def fragile(health: Path, **settings: Any) -> TaskFamily:
    health.touch()
    return gymnasium_family(
        "fragile", partial(make_fragile, health), draw_walks, horizon=HORIZON, **settings
    )


def new_run(directory: Path, family: TaskFamily) -> Run:
    learner = tiny_maesn(normalize_observations=True)
    return Run.create(
        directory, learner, tiny_settings(checkpoint_every=3, num_threads=1), family=family
    )


def test_after_a_failure_the_checkpoint_is_good_and_the_run_goes_on(tmp_path: Path) -> None:
    health = tmp_path / "health"
    family = fragile(health)
    whole = finish(new_run(tmp_path / "whole", family), 4)
    run = new_run(tmp_path / "run", family)
    training = train(run, 4)
    next(training)
    health.unlink()
    with pytest.raises(EpisodeError, match="OSError: the robot is not well"):
        next(training)
    assert run.latest().iteration == 1
    health.touch()
    finish(run, 4)
    assert tensors(run.checkpoints()[-1]) == tensors(whole.checkpoints()[-1])
    assert metrics(run) == metrics(whole)


@pytest.mark.usefixtures("figures_unsaved")
def test_figures_that_need_positions_are_left_out(tmp_path: Path) -> None:
    family = fragile(tmp_path / "health", max_environments=40)
    run = new_run(tmp_path / "run", family)
    write_metrics(run.directory / "metrics.jsonl", learning_curve())
    # In more tasks than there may be environments: forty at a time.
    assert adapt(run, episodes=0, episodes_per_update=1).curves.mean_return.shape == (100, 1)
    names = {path.name for path in report([run.directory], family=family).files}
    assert "learning-dense.png" in names
    assert "exploration-test-sparse.png" not in names


def test_a_reward_that_is_not_given_cannot_be_read(tmp_path: Path) -> None:
    """An environment gives one reward at a time: the dense one in training, and no sparse one."""
    directory = tmp_path / "run"
    reader = rl2(policy=Recurrent(hidden_size=4, readout_sizes=(4,), observed_reward="sparse"))
    family = gymnasium_family("walk", make_walker, draw_walks, horizon=HORIZON)
    with pytest.raises(RunError, match="gives the dense reward alone"):
        Run.create(directory, reader, tiny_settings(), family=family)
    assert not directory.exists()
    given = tiny_settings(reward="sparse")
    assert Run.create(directory, reader, given, family=family).learner == reader
    with pytest.raises(RunError, match="reads the sparse one"):
        adapt(directory, reward="dense", episodes=0, episodes_per_update=1, family=family)
