"""The example of another latent: its prior is learned, and new tasks start from it."""

from pathlib import Path

import jax
import numpy as np
import pytest
from pages import ROOT

import maesn
from maesn import cli

SMALL = ["--meta-batch-size", "4", "--episodes-per-task", "4", "--policy.hidden-sizes", "8"]
NAME = "own_latent:maesn_learned_prior"


@pytest.fixture(autouse=True)
def examples(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(ROOT / "examples")
    monkeypatch.chdir(tmp_path)


def train(run: str, iterations: int) -> maesn.Run:
    words = ["--family", "point", "--run", run, "--iterations", str(iterations), *SMALL]
    assert cli.run(["train", NAME, *words]) == 0
    return maesn.Run.open(run)


def test_the_prior_is_learned_and_new_tasks_start_from_it() -> None:
    run = train("run", 3)
    prior = run.latest_state().parameters.context_table.prior
    assert np.any(prior.mean != 0.0)
    assert np.any(prior.log_std != 0.0)
    fast = run.learner.fast_learner(run.latest_state())
    start = fast.agents(fast.init(jax.random.split(jax.random.key(0), 2))).context
    np.testing.assert_array_equal(start.mean, np.tile(prior.mean, (2, 1)))


def test_it_resumes_bit_for_bit_and_adapts() -> None:
    train("whole", 3)
    train("parts", 1)
    assert cli.run(["resume", "parts", "--iterations", "3", "--method", NAME]) == 0
    metrics = [Path(run, "metrics.jsonl").read_text("utf-8") for run in ("whole", "parts")]
    assert metrics[0] == metrics[1]
    done = maesn.adapt("parts", method=NAME, num_tasks=2, episodes=4, episodes_per_update=2)
    assert np.isfinite(done.curves.mean_return).all()
    assert done.latents is not None
