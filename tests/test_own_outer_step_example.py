"""The example of an outer step of one's own."""

from pathlib import Path

import jax
import numpy as np
import pytest
from pages import ROOT

import maesn
from maesn import cli

NAME = "own_outer_step:maesn_promp"
SMALL = ["--meta-batch-size", "4", "--episodes-per-task", "4", "--policy.hidden-sizes", "8"]


@pytest.fixture(autouse=True)
def examples(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(ROOT / "examples")
    monkeypatch.chdir(tmp_path)


def train(run: str, iterations: int, *more: str) -> maesn.Run:
    words = ["--family", "point", "--run", run, "--iterations", str(iterations), *SMALL, *more]
    assert cli.run(["train", NAME, *words]) == 0
    return maesn.Run.open(run)


def test_it_is_short() -> None:
    assert len((ROOT / "examples" / "own_outer_step.py").read_text("utf-8").splitlines()) <= 60


def test_it_resumes_bit_for_bit_with_the_optimisers_moments() -> None:
    whole = train("whole", 3)
    train("parts", 1)
    assert cli.run(["resume", "parts", "--iterations", "3", "--method", NAME]) == 0
    metrics = [Path(run, "metrics.jsonl").read_text("utf-8") for run in ("whole", "parts")]
    assert metrics[0] == metrics[1]
    moments = whole.latest_state().opt_state[0].mu.policy
    assert all(np.any(leaf != 0.0) for leaf in jax.tree.leaves(moments))


def test_the_penalty_holds_the_policy_back() -> None:
    heavy = train("heavy", 1, "--outer.divergence-weight", "1e3")
    assert heavy.learner.outer.divergence_weight == 1e3
    free = train("free", 1, "--outer.divergence-weight", "0")
    start = free.untrained_state().parameters.policy.log_std
    moved = [
        np.abs(run.latest_state().parameters.policy.log_std - start).max() for run in (heavy, free)
    ]
    assert moved[0] < 0.9 * moved[1]
