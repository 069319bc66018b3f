"""The oracle, which is given the task, returns what no other policy can; and its verbs."""

from pathlib import Path

import jax
import pytest
from learning_problems.probes import hidden_target
from small_runs import create, finish

from maesn import api
from maesn.evaluation.evaluate import adapt
from maesn.learners import Problem, oracle
from maesn.policies import GaussianMLP
from maesn.storage import RunError
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

SMALL = {"policy": GaussianMLP((8,)), "meta_batch_size": 4}


def test_the_oracle_beats_every_policy_that_is_not_told() -> None:
    # Without the task, -0.595 is the best there is (`learning_problems.probes`); with it, 0.
    env, tasks = hidden_target.make_env(), hidden_target.task_set("training", 20)
    learner = oracle(policy=GaussianMLP((16,)), meta_batch_size=10)
    state = learner.init(jax.random.key(0), Problem(env.observation_size, env.action_size, 20, 2))
    collect = Collector(make_world(env, tasks), 10)
    for step in range(80):
        state, _ = learner.step(jax.random.key(step), state, collect)
    unseen = Collector(make_world(env, hidden_target.task_set("test", 20)), 20)
    curves = adapt(learner.fast_learner(state), unseen, episodes=0).curves
    assert curves.mean_return.mean() > -0.3


def test_verbs_of_an_oracle(tmp_path: Path) -> None:
    run = finish(create(tmp_path / "run", oracle(**SMALL), iterations=2))
    curves = api.adapt(run.directory, episodes=2, episodes_per_update=2).outcome.curves
    assert curves.mean_return.shape == (100, 2)
    names = {path.stem for path in api.report([run.directory]).files}
    assert {"curves-test-sparse", "exploration-test-sparse"} <= names
    begun = api.train(oracle(**SMALL), run.settings, tmp_path / "begun", init_from=run.directory)
    assert begun.latest().iteration == 2
    with pytest.raises(RunError, match="must adapt a latent alone"):
        api.export(run.directory, tmp_path / "policy.npz")
