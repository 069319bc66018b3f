"""The example of a meta-learner around another one: what it learns from, and nothing else."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meta_curiosity import WithCuriosity
from playing import keys
from small_runs import tiny_maesn

import maesn
from maesn import cli, oracle
from maesn.envs import point
from maesn.learners import Problem
from maesn.learners.gradient.fast_learner import GradientFastLearner
from maesn.policies import GaussianMLP
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

SMALL = maesn.CuriosityBonus(
    hidden_sizes=(4,), updates=5, pool_size=40, pool_additions=20, samples=2
)
NAME = "meta_curiosity:WithCuriosity"
TASKS = 3
PROBLEM = Problem(2, 2, 100)


@pytest.fixture(scope="module")
def collect() -> Collector:
    # As in the run below, so that they share compiled programs.
    return Collector(make_world(point.make_env(), point.task_set("training")), 3)


def tiny() -> Any:
    return tiny_maesn(policy=GaussianMLP((4,)), meta_batch_size=2)


def test_it_learns_from_reward_and_bonus(collect: Collector) -> None:
    learner = WithCuriosity(tiny(), replace(SMALL, pool_size=200, weight=10.0))
    state = learner.init(jax.random.key(0), PROBLEM)
    for step in range(4):
        state, info = learner.step(jax.random.key(step), state, collect)
        # As long as the model has learned nothing, there is no bonus.
        assert (float(info.curiosity.bonus) > 8 * 5.0) == (step > 0)
    assert int(learner.iteration(state)) == 4
    assert all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(state))
    # Two collections per iteration, 20 of the transitions of each.
    assert int(state.curiosity.pool.count) == 160
    # Reported are returns without bonus: at most 0 on this family.
    assert float(info.learner.return_after) < 0


def test_with_a_weight_of_0_it_is_the_learner_itself(collect: Collector) -> None:
    wrapped, key = WithCuriosity(tiny(), replace(SMALL, weight=0.0)), jax.random.key(7)
    state = wrapped.init(jax.random.key(0), PROBLEM)
    after, info = tiny().step(jax.random.split(key, 3)[0], state.learner, collect)
    together, said = wrapped.step(key, state, collect)
    for one, other in zip(*map(jax.tree.leaves, (after, together.learner)), strict=True):
        np.testing.assert_array_equal(one, other)
    for measure in ("return_before", "return_after"):
        wanted = float(getattr(info, measure))
        assert float(getattr(said.learner, measure)) == pytest.approx(wanted, rel=1e-5)


def test_the_model_of_the_dynamics_passes_on_to_new_tasks(collect: Collector) -> None:
    learner = WithCuriosity(tiny(), SMALL)
    begun = learner.init(jax.random.key(0), PROBLEM)
    state, _ = learner.step(jax.random.key(1), begun, collect)
    fast = learner.fast_learner(state)
    assert (fast.observation_size, fast.action_size) == (2, 2)
    begun = fast.init(keys(TASKS))
    # The network means nothing without the pool, by whose moments its inputs are scaled.
    for part in ("network", "pool"):
        handed_over = (getattr(one.curiosity, part) for one in (state, begun))
        for known, start in zip(*map(jax.tree.leaves, handed_over), strict=True):
            np.testing.assert_array_equal(start, jnp.stack([known] * TASKS))


def test_a_learner_that_does_not_learn_from_reward_gets_no_bonus() -> None:
    learner = WithCuriosity(oracle(policy=GaussianMLP((4,)), meta_batch_size=2))
    fast = learner.fast_learner(learner.init(jax.random.key(0), Problem(2, 2, 5, 2)))
    assert isinstance(fast, GradientFastLearner)


def test_it_is_trained_resumed_and_adapted_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    small = "--episodes-per-task 3 --learner.meta-batch-size 2 --learner.policy.hidden-sizes 4"
    own = "--curiosity.hidden-sizes 4 --curiosity.updates 5 --curiosity.weight 10"
    own += " --curiosity.pool-size 200 --curiosity.pool-additions 20 --curiosity.samples 2"
    for run, iterations in (("whole", 2), ("parts", 1)):
        words = f"train {NAME} --family point --iterations {iterations} --run {run} {small} {own}"
        assert cli.run(words.split()) == 0
    assert cli.run(f"resume parts --iterations 2 --method {NAME}".split()) == 0
    metrics = [Path(run, "metrics.jsonl").read_text("utf-8") for run in ("whole", "parts")]
    assert metrics[0] == metrics[1]
    assert "curiosity/bonus" in metrics[0]
    run = maesn.Run.open("parts", method=NAME)
    assert (run.settings.method, run.learner.curiosity.weight) == (NAME, 10.0)
    few = {"num_tasks": 2, "episodes": 6, "episodes_per_update": 3, "reward": "dense"}
    assert np.isfinite(maesn.adapt(run, **few).curves.mean_return).all()
    with pytest.raises(maesn.RunError, match="must not have a bonus already"):
        maesn.adapt(run, wrappers=(maesn.VimeBonus(),), **few)
