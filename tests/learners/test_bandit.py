"""RL2 on Bernoulli bandits against the optimum of dynamic programming."""

import itertools
import math

import bandit as benchmark
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bernoulli_bandit import Bandit, bandit
from scripts import ROOT

COMMITTED = ROOT / "results" / "bandit" / "policy.safetensors"


def best_of_all_policies(arms: int, pulls: int) -> float:
    """By enumeration: a policy is an arm for every sequence of rewards so far."""
    sequences = [
        rewards for length in range(pulls) for rewards in itertools.product((0, 1), repeat=length)
    ]
    outcomes = list(itertools.product((0, 1), repeat=pulls))
    policies = itertools.product(range(arms), repeat=len(sequences))
    return max(
        sum(
            weighted_return(dict(zip(sequences, policy, strict=True)), rewards)
            for rewards in outcomes
        )
        for policy in policies
    )


def weighted_return(policy: dict[tuple[int, ...], int], rewards: tuple[int, ...]) -> float:
    """Probability of a sequence of rewards under a policy, times its sum.

    The task is integrated out: an arm with a rewards and b failures has the probability
    a! b! / (a + b + 1)!, whatever their order.
    """
    pulled = np.array([policy[rewards[:t]] for t in range(len(rewards))])
    probability = 1.0
    for arm in set(pulled):
        won = int(np.sum(np.array(rewards)[pulled == arm]))
        lost = int(np.sum(pulled == arm)) - won
        probability *= math.factorial(won) * math.factorial(lost) / math.factorial(won + lost + 1)
    return probability * sum(rewards)


def test_dynamic_programming_is_the_best_of_all_policies() -> None:
    for arms, pulls in ((2, 1), (3, 1), (2, 2), (2, 3), (3, 2)):
        expected = best_of_all_policies(arms, pulls)
        assert benchmark.bayes_optimal_return(arms, pulls) == pytest.approx(expected)


def test_the_bandit_pays_as_often_as_its_arms_say() -> None:
    """Always the second arm, of probability 0.3: 20,000 pulls have a standard error of 0.003."""
    env, task = Bandit(), jnp.asarray([0.9, 0.3, 0.0, 1.0, 0.5])
    arm = jnp.eye(5)[1]

    def total(key: jax.Array) -> jax.Array:
        qpos, qvel = env.initial(key, task)
        readings, total = {"qpos": qpos, "qvel": qvel}, jnp.zeros(())
        for _ in range(env.horizon):
            after = env.advance(readings, arm)
            total += env.reward(readings, arm, after, task).total
            readings = after
        return total

    totals = np.asarray(jax.vmap(total)(jax.random.split(jax.random.key(0), 2000)))
    assert totals.mean() / env.horizon == pytest.approx(0.3, abs=0.013)
    # And independently: the sum is binomial, not all or nothing.
    assert totals.var() == pytest.approx(10 * 0.3 * 0.7, rel=0.15)


def test_the_published_policy_is_close_to_the_optimum() -> None:
    """5 arms, 10 pulls, 20,000 new tasks: within 0.15 of 6.66; the standard error is 0.016."""
    policy = benchmark.load_policy(COMMITTED)
    env, tasks = Bandit(), bandit.task_set("test", benchmark.TEST_TASKS)
    mean, error = benchmark.evaluate(policy, benchmark.make_collect(tasks, env))
    assert error < 0.02
    optimum = benchmark.bayes_optimal_return(benchmark.ARMS, benchmark.PULLS)
    assert optimum - 0.15 + 3 * error < mean < optimum + 3 * error
