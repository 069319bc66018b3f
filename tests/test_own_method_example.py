"""The method of the page "Add a method": trained, resumed, adapted, compared and exported."""

from pathlib import Path

import numpy as np
import pytest
from pages import ROOT, blocks_of

import maesn
from maesn import cli

SMALL = ["--meta-batch-size", "2", "--episodes-per-task", "2", "--policy.hidden-sizes", "8"]
NAME = "own_method:Reptile"


@pytest.fixture(autouse=True)
def examples(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(ROOT / "examples")
    monkeypatch.chdir(tmp_path)


def train(run: str, iterations: int) -> None:
    words = ["--family", "point", "--run", run, "--iterations", str(iterations), *SMALL]
    assert cli.run(["train", NAME, *words]) == 0


def test_it_resumes_bit_for_bit_and_adapts_by_its_own_learner() -> None:
    train("whole", 3)
    train("parts", 1)
    assert cli.run(["resume", "parts", "--iterations", "3", "--method", NAME]) == 0
    metrics = [Path(run, "metrics.jsonl").read_text("utf-8") for run in ("whole", "parts")]
    assert metrics[0] == metrics[1]
    few = {"num_tasks": 2, "episodes": 4, "episodes_per_update": 2}
    done = maesn.adapt("parts", reward="dense", method=NAME, **few)
    assert done.curves.mean_return.shape == (2, 3)
    assert np.isfinite(done.curves.mean_return).all()


def test_the_page_has_it_in_a_study(tmp_path: Path) -> None:
    (study,) = blocks_of(ROOT / "docs" / "howto" / "own_method.md", "toml")
    plan = maesn.Study.load(_written(tmp_path / "reptile.toml", study)).jobs
    trained = [job for job in plan.values() if "Reptile" in job.name and job.iterations]
    assert [job.iterations for job in trained] == [100] * 3
    # 100 iterations of 3 updates in 10 tasks with 20 episodes, and the horizon of `point`.
    horizon = maesn.FAMILIES["point"].make_env().horizon
    assert {job.steps for job in trained} == {100 * 3 * 10 * 20 * horizon}


def _written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path
