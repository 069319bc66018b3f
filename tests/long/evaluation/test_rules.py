"""A run with a curiosity bonus, from the command line to the table."""

from pathlib import Path

import numpy as np
import pytest

from maesn import api, cli
from maesn.learners import (
    BonusMetaLearner,
)
from maesn.policies import GaussianMLP
from maesn.rules import (
    VimeBonus,
)
from maesn.runs.run import Run
from maesn.storage import RunError

FEW = {"episodes": 6, "episodes_per_update": 3}


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("goals") / "few.npz"
    np.savez(path, goal=np.float32([[0.0, 2.0], [2.0, 0.0]]))
    return str(path)


def test_a_run_with_a_bonus_is_trained_stored_and_adapted(tmp_path: Path, few: str) -> None:
    command = (
        "train maesn+curiosity --family point --reward sparse --iterations 1 "
        "--episodes-per-task 3 --learner.meta-batch-size 2 --learner.policy.hidden-sizes 4 "
        f"--curiosity.updates 2 --curiosity.weight 0.5 --run {tmp_path / 'run'}"
    )
    assert cli.run(command.split()) == 0
    run = Run.open(tmp_path / "run")
    assert run.settings.method == "maesn+curiosity"
    assert isinstance(run.learner, BonusMetaLearner)
    assert run.learner.curiosity.weight == 0.5
    assert run.learner.learner.policy == GaussianMLP((4,))
    assert run.latest().iteration == 1
    assert "bonus" in (run.directory / "metrics.jsonl").read_text()
    api.adapt(run, tasks=few, **FEW)
    with pytest.raises(RunError, match="it has a curiosity bonus already"):
        api.adapt(run, tasks=few, wrappers=(VimeBonus(),))
