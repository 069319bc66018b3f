"""Baselines: what they play, and its return, in closed form."""

import jax.numpy as jnp
import numpy as np
import scipy.stats
from bernoulli_bandit import bandit
from learning_problems.probes import hidden_target
from playing import keys

from maesn import FixedPolicy
from maesn.envs import AnyEnv, point
from maesn.evaluation.adapting import adapt
from maesn.learners import baselines
from maesn.worlds import make_world
from maesn.worlds.collector import Collector


def of(env: AnyEnv) -> dict[str, FixedPolicy]:
    return baselines(env.observation_size, env.action_size, env.action_kind)


def test_the_floor_of_a_quadratic_bandit_is_what_the_formula_says() -> None:
    # a ~ N(m, s^2 I) returns -(|m - g|^2 + 2 s^2) on average, and |g| = 1.
    env, tasks, episodes = hidden_target.make_env(), hidden_target.task_set("test", 20), 500
    collect = Collector(make_world(env, tasks), episodes)
    curves = {name: adapt(fixed, collect, episodes=0).curves for name, fixed in of(env).items()}
    np.testing.assert_allclose(curves["zero action"].mean_return, -1.0, atol=1e-4)
    # -|a - g|^2 is minus a non-central chi-square of 2 degrees and non-centrality 1: variance 8.
    error = np.sqrt(8 / (20 * episodes))
    assert abs(curves["random actions"].mean_return.mean() + 3.0) < 4 * error


def test_random_actions_are_standard_normal_and_zero_is_zero() -> None:
    env, tasks = point.make_env(), point.task_set("test", 4)
    collect = Collector(make_world(env, tasks), 20)
    for name, size in (("random actions", 1.0), ("zero action", 1e-6)):
        learner = of(env)[name]
        state = learner.init(keys(4))
        actions = collect(keys(4), learner.agents(state), jnp.arange(4)).action
        found = scipy.stats.kstest(np.ravel(actions) / size, "norm").pvalue
        assert found > 1e-4  # chance of a false alarm, for these keys alone


def test_choices_have_the_same_probability_each() -> None:
    env, tasks = bandit.make_env(), bandit.task_set("test", 10)
    learners = of(env)
    assert list(learners) == ["random choices"]
    agents = learners["random choices"].agents(None)
    actions = Collector(make_world(env, tasks), 50)(keys(10), agents, jnp.arange(10)).action
    counts = np.asarray(actions).sum((0, 1, 2))
    assert scipy.stats.chisquare(counts).pvalue > 1e-4
