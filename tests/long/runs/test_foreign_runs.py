"""Everything that can be done with a run works in a foreign environment."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pictures import can_draw, drawn
from small_runs import finish, tiny_maesn, tiny_settings
from strangers import HORIZON, draw_walks, make_fragile

from maesn.api import adapt, export, report
from maesn.envs import TaskFamily
from maesn.envs.foreign import gymnasium_family
from maesn.evaluation import exploration
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.film import render
from maesn.runs.run import Run
from maesn.runtime import Explorer


def fragile(health: Path, **settings: Any) -> TaskFamily:
    health.touch()
    return gymnasium_family(
        "fragile", partial(make_fragile, health), draw_walks, horizon=HORIZON, **settings
    )


def new_run(directory: Path, family: TaskFamily) -> Run:
    learner = tiny_maesn(normalize_observations=True)
    return Run.create(directory, learner, tiny_settings(checkpoint_every=3), family=family)


def test_every_verb_works_on_a_foreign_family(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    family = fragile(
        tmp_path / "health",
        position=lambda observation: observation[-2:],
        goal=lambda task: task[:2],
        max_environments=40,
    )
    run = finish(new_run(tmp_path / "run", family), 1)
    # Twice as many episodes of all tasks as there may be environments: ten tasks at a time.
    outcome = adapt(run, episodes=4, episodes_per_update=4)
    assert outcome.curves.mean_return.shape == (100, 2)
    monkeypatch.setattr(exploration, "EXPLORATION_EPISODES", 5)
    names = {path.name for path in report([run.directory], family=family).files}
    assert {"exploration-test-sparse.png", "curves-test-sparse.png"} <= names
    few = Evaluation(episodes=2, episodes_per_update=2)
    pictures = drawn(lambda: render(run, few, after=[0], shown=1)) or []
    assert all(path.parent == run.directory / "render" for path in pictures)
    assert len(pictures) == (2 if can_draw() else 0)
    explorer = Explorer.load(export(run.directory, tmp_path / "policy.npz", family=family), seed=0)
    explorer.begin_episode()
    control = explorer.act(np.zeros(10))
    assert np.all((control >= [-1, 0]) & (control <= [1, 0.5]))
