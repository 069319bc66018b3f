"""Deliberate changes of a run that has begun: made, recorded, and refused where they cannot be."""

import json
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from small_runs import create, create_tiny, finish, outcome, reopened

from maesn import cli
from maesn.runs.run import Run
from maesn.runs.serialization import values_of_words
from maesn.runs.training import change_run
from maesn.storage import RunError


def test_a_change_takes_effect_from_the_latest_checkpoint_on(tmp_path: Path) -> None:
    run = finish(create(tmp_path / "run"), iterations=2)
    before = run.config.digest()
    changed = change_run(run, {"seed": 5, "scale": 3})
    assert (changed.settings.seed, changed.learner.scale) == (5, 3.0)
    assert reopened(run).config == changed.config
    (record,) = json.loads((run.directory / "config.json").read_text())["changes"]
    assert record == {"iteration": 2, "changed": {"seed": 5, "scale": 3}, "digest": before}
    finish(changed)
    # By hand: the first two iterations draw as seed 0 says, the others as seed 5 and three times
    # as far.
    other = create(tmp_path / "other", seed=5)
    steps = [draw(run, n) for n in range(2)]
    steps += [3 * draw(other, n) for n in range(2, 6)]
    np.testing.assert_allclose(reopened(run).latest_state().position, sum(steps), rtol=1e-5)
    # Every checkpoint is still the run's own.
    opened = reopened(run)
    assert [opened.load(path).iteration for path in opened.checkpoints()] == [0, 2, 4, 6]


def draw(run: Run, iteration: int) -> np.ndarray:
    return np.asarray(jax.random.normal(run.iteration_key(iteration), (3,)))


def test_a_change_that_changes_nothing_leaves_the_numbers(tmp_path: Path) -> None:
    whole = outcome(finish(create(tmp_path / "whole")))
    run = finish(create(tmp_path / "run"), iterations=3)
    for value in (2, 1):
        run = change_run(run, {"num_threads": value})
    assert len(reopened(run).config.changes) == 2
    assert outcome(finish(run)) == whole


def test_the_world_changes_with_its_settings(tmp_path: Path) -> None:
    run = change_run(create_tiny(tmp_path / "run"), {"reward": "sparse", "sparse_radius": 1})
    env = reopened(run).env()
    assert (env.reward_kind, env.sparse_radius) == ("sparse", 1.0)
    assert run.config.world["sparse_radius"] == 1.0


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"family": "wheeled"}, "family"),
        ({"variant": "paper"}, "variant"),
        ({"method": "maml"}, "method"),
        ({"policy.hidden_sizes": [4]}, "policy.hidden_sizes"),
        ({"context": {"type": "NoContext"}}, "context"),
        ({"context.type": "NoContext"}, "context.type"),
        ({"damping": 0.1}, "outer.trust_region.damping"),  # the whole name of what may be meant
        ({"seed": "5"}, "seed"),
        ({"seed": -1}, "seed"),
        ({"sparse_radius": None}, "sparse_radius"),
        ({"outer.trust_region.damping": -1.0}, "damping"),
        ({"meta_batch_size": 500}, "meta_batch_size"),
    ],
)
def test_what_cannot_change_is_refused(
    directory: Path, changes: dict[str, Any], named: str
) -> None:
    before = (directory / "config.json").read_bytes()
    with pytest.raises(RunError, match=named):
        change_run(Run.open(directory), changes)
    assert (directory / "config.json").read_bytes() == before


def test_changes_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["num_threads=2", "outer.trust-region.damping=0.1", "reward=sparse"]
    wanted = {"num_threads": 2, "outer.trust_region.damping": 0.1, "reward": "sparse"}
    assert values_of_words(words) == wanted
    run = create_tiny(tmp_path / "run", iterations=0)
    assert cli.run(["resume", str(run.directory), "--change", *words]) == 0
    opened = reopened(run)
    assert opened.settings.num_threads == 2
    assert opened.learner.outer.trust_region.damping == 0.1
    assert opened.config.changes[0].changed == wanted
    for word in ("reward", "=3", "reward=a reward=b"):
        with pytest.raises(ValueError, match="NAME=VALUE"):
            values_of_words(word.split())
    assert cli.run(["resume", str(run.directory), "--change", "tasks=test"]) == cli.USAGE_ERROR
    assert "`tasks`" in capsys.readouterr().err
