"""The examples of a method, a latent and an outer step of one's own; the page "Add a method"."""

from pathlib import Path

import jax
import numpy as np
import pytest
from pages import ROOT, blocks_of

import maesn
from maesn import cli

METHOD, LATENT = "own_method:Reptile", "own_latent:maesn_learned_prior"
OUTER_STEP = "own_outer_step:maesn_promp"
SMALL = ["--meta-batch-size", "4", "--episodes-per-task", "4", "--policy.hidden-sizes", "8"]


@pytest.fixture(autouse=True)
def examples(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)


def train(name: str, run: str, iterations: int, *more: str) -> maesn.Run:
    words = ["--family", "point", "--run", run, "--iterations", str(iterations), *SMALL, *more]
    assert cli.run(["train", name, *words]) == 0
    return maesn.Run.open(run)


@pytest.mark.parametrize(
    ("name", "most"), [("own_method", 120), ("own_latent", 80), ("own_outer_step", 60)]
)
def test_it_is_short(name: str, most: int) -> None:
    assert len((ROOT / "examples" / f"{name}.py").read_text("utf-8").splitlines()) <= most


@pytest.mark.parametrize("name", [METHOD, LATENT, OUTER_STEP])
def test_it_resumes_bit_for_bit_and_adapts(name: str) -> None:
    train(name, "whole", 3)
    train(name, "parts", 1)
    assert cli.run(["resume", "parts", "--iterations", "3", "--method", name]) == 0
    metrics = [Path(run, "metrics.jsonl").read_text("utf-8") for run in ("whole", "parts")]
    assert metrics[0] == metrics[1]
    # As many as in training, so that programs are compiled once.
    few = {"num_tasks": 4, "episodes": 8, "episodes_per_update": 4}
    done = maesn.adapt("parts", reward="dense", method=name, **few)
    assert done.curves.mean_return.shape == (4, 3)
    assert np.isfinite(done.curves.mean_return).all()
    assert (done.latents is None) == (name == METHOD)


def test_the_prior_of_the_latent_is_learned_and_new_tasks_start_from_it() -> None:
    run = train(LATENT, "run", 3)
    prior = run.latest_state().parameters.context_table.prior
    assert np.any(prior.mean != 0.0)
    assert np.any(prior.log_std != 0.0)
    fast = run.learner.fast_learner(run.latest_state())
    start = fast.agents(fast.init(jax.random.split(jax.random.key(0), 2))).context
    np.testing.assert_array_equal(start.mean, np.tile(prior.mean, (2, 1)))


def test_the_page_has_the_method_in_a_study(tmp_path: Path) -> None:
    (text,) = blocks_of(ROOT / "docs" / "howto" / "own_method.md", "toml")
    (tmp_path / "reptile.toml").write_text(text, encoding="utf-8")
    study = maesn.Study.load(tmp_path / "reptile.toml")
    methods = {line.first.method for one in study.comparisons for line in one.lines["lines"]}
    assert METHOD in methods  # as `maesn train` records it
    trained = [job for job in study.jobs.values() if "Reptile" in job.name and job.iterations]
    assert [job.iterations for job in trained] == [100] * 3
    # 100 iterations of 3 updates in 10 tasks with 20 episodes, and the horizon of `point`.
    horizon = maesn.FAMILIES["point"].make_env().horizon
    assert {job.steps for job in trained} == {100 * 3 * 10 * 20 * horizon}


def test_the_outer_step_keeps_its_moments_and_the_penalty_holds_the_policy_back() -> None:
    moved = []
    for weight in ("1e3", "0"):
        run = train(OUTER_STEP, weight, 1, "--outer.divergence-weight", weight)
        assert run.learner.outer.divergence_weight == float(weight)
        state, start = run.latest_state(), run.untrained_state().parameters.policy.log_std
        moved.append(np.abs(state.parameters.policy.log_std - start).max())
        moments = state.opt_state[0].mu.policy
        assert all(np.any(leaf != 0.0) for leaf in jax.tree.leaves(moments))
    assert moved[0] < 0.9 * moved[1]
