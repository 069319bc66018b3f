"""Runs of the recurrent method: trained, resumed, adapted; and what cannot be done with them."""

import csv
from pathlib import Path

import pytest
from small_runs import create

from maesn import ProximalStep, RecurrentMetaLearner, RecurrentValue, api, rl2
from maesn.numerics import MinibatchDescent
from maesn.policies import Recurrent

DESCENT = MinibatchDescent(epochs=1, minibatches=2)


def tiny() -> RecurrentMetaLearner:
    return rl2(
        policy=Recurrent(hidden_size=3, observed_reward="sparse"),
        policy_step=ProximalStep(descent=DESCENT),
        value=RecurrentValue((), 3, (), DESCENT),
        meta_batch_size=2,
    )


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return create(tmp_path_factory.mktemp("runs") / "whole", tiny(), iterations=3).directory


def test_in_new_tasks_an_update_is_one_more_episode(trained: Path) -> None:
    done = api.adapt(trained, episodes=4, episodes_per_update=2)
    adaptation = done.outcome
    assert adaptation.episodes_per_update == 1
    assert adaptation.trial_episodes == 2
    with done.table.open() as file:
        rows = list(csv.DictReader(file))
    assert [row["episodes"] for row in rows[:3]] == ["0", "1", "2"]
    assert done.latents is None
    assert not list(done.table.parent.glob("*.npz"))
