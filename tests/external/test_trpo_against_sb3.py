"""TRPO from scratch against that of `sb3-contrib`, on an environment that neither of them wrote.

It needs PyTorch. Both learn CartPole for the same number of steps, with networks of the same size;
the return that counts is the one at the end.
"""

from typing import Any

import gymnasium
import numpy as np
from sb3_contrib import TRPO
from stable_baselines3.common.evaluation import evaluate_policy

from maesn.envs.foreign import gymnasium_family
from maesn.evaluation.adapting import adapt
from maesn.learners import SCRATCH
from maesn.policies import CategoricalMLP
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

STEPS = 100_000
HIDDEN = (64, 64)
EPISODES, UPDATES, RUNS = 30, 60, 3


def make_cart_pole(task: Any, reward: str) -> gymnasium.Env:
    return gymnasium.make("CartPole-v1")


def draw_tasks(stream: np.random.Generator, size: int) -> np.ndarray:
    """Tasks that differ in nothing but their index: each is a run of its own."""
    return np.arange(size, dtype=np.float32)


cart_pole = gymnasium_family("cart_pole", make_cart_pole, draw_tasks, control_period=0.02)


def ours() -> float:
    """Mean return after as many steps, over runs; sampled actions, as the learner plays."""
    env = cart_pole.make_env()
    world = make_world(env, cart_pole.task_set("test", RUNS), num_threads=2)
    learner = SCRATCH["trpo"](env.observation_size, env.action_size, policy=CategoricalMLP(HIDDEN))
    try:
        outcome = adapt(learner, Collector(world, EPISODES), episodes=UPDATES * EPISODES)
    finally:
        world.close()
    returns = outcome.curves.mean_return
    # CartPole rewards every step with 1, so the sum is the number of steps that were learned from.
    # One that has not come that far counts as it is: it has not learned to survive.
    done = np.argmax(np.cumsum(EPISODES * returns, axis=1) >= STEPS, axis=1)
    last = np.where(done > 0, done, UPDATES)
    return float(
        np.mean([run[end - 2 : end + 1].mean() for run, end in zip(returns, last, strict=True)])
    )


def theirs() -> float:
    """The same of `sb3-contrib`: discount 0.99, KL bound 0.01 and the rest its own defaults."""
    network = {"net_arch": list(HIDDEN)}
    ends = []
    for seed in range(RUNS):
        model = TRPO("MlpPolicy", "CartPole-v1", seed=seed, device="cpu", policy_kwargs=network)
        model.learn(STEPS)
        mean, _ = evaluate_policy(
            model, model.get_env(), n_eval_episodes=20, deterministic=False, warn=False
        )
        ends.append(mean)
    return float(np.mean(ends))


def test_both_end_within_ten_percent() -> None:
    found, expected = ours(), theirs()
    assert expected > 300, "the other library has not learned, so that this compares nothing"
    assert abs(found - expected) <= 0.1 * expected, (found, expected)
