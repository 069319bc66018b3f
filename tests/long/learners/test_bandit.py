"""RL2 learns a small Bernoulli bandit, against the optimum of dynamic programming."""

from types import ModuleType

import numpy as np
import pytest
from bernoulli_bandit import Bandit
from scripts import load_script

from maesn.envs import TaskSet
from maesn.evaluation.evaluate import adapt
from maesn.evaluation.evaluation import Evaluation
from maesn.learners import RecurrentFastLearner


@pytest.fixture(scope="module")
def benchmark() -> ModuleType:
    return load_script("benchmarks/bandit.py")


def test_rl2_learns_to_play_a_small_bandit(benchmark: ModuleType) -> None:
    """2 arms, 5 pulls. Pulling blindly returns 2.5, the optimum is 2.889; two thirds of the gap
    have to be closed within seconds. The standard error of 10,000 trials is 0.014."""
    env, stream = Bandit(horizon=5, action_size=2), np.random.default_rng(0)
    training, test = (
        TaskSet(stream.uniform(size=(n, 2)).astype(np.float32)) for n in (4000, 10000)
    )
    learner = benchmark.make_learner(500)
    policy = benchmark.train(learner, benchmark.make_collect(training, env), env, 120)
    outcome = adapt(
        RecurrentFastLearner(policy, 1),
        benchmark.make_collect(test, env),
        Evaluation(tasks_at_once=10000),
        episodes=0,
    )
    optimum = benchmark.bayes_optimal_return(2, 5)
    assert optimum == pytest.approx(26 / 9)
    mean = outcome.curves.mean_return.mean()
    assert optimum - 0.15 + 3 * 0.014 < mean < optimum + 3 * 0.014
