"""Gradient-based methods learn to learn, from scratch: on a probe that nobody solves without it.

A blind agent walks to a side that it does not know. Over the two sides, the mean return of any
policy that has not adapted is 0; the best return is 1.
"""

from typing import Any

import jax
import numpy as np

from learning_problems.probes import HiddenSide
from maesn.context import LatentContext
from maesn.envs import TaskSet
from maesn.evaluation.adapting import adapt
from maesn.evaluation.evaluation import Evaluation
from maesn.learners import PRESETS, Problem
from maesn.learners.gradient.outer import TrustRegionOuterStep
from maesn.numerics.trust_region import TrustRegion
from maesn.policies import GaussianMLP
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

TASKS, EPISODES, SIGMAS = 20, 20, 5


def make_collect() -> Collector:
    sides = TaskSet(np.float32([-1.0, 1.0] * (TASKS // 2)))
    return Collector(make_world(HiddenSide(horizon=4), sides), EPISODES)


# At first the noise of the actions hides what z does to them.
NOISY = {
    "policy": GaussianMLP((), initial_std=3.0),
    "outer": TrustRegionOuterStep(TrustRegion(max_kl=0.03, damping=1e-2), curvature_stride=1),
}
SLOTS: dict[str, dict[str, Any]] = {
    "maesn": NOISY | {"context": LatentContext(initial_spread=0.0)},
    "maml": {"policy": GaussianMLP(()), "outer": TrustRegionOuterStep(curvature_stride=1)},
    # Trained without an inner update, its latents need more than one update in a new task.
    "latent_space": NOISY | {"context": LatentContext(initial_spread=0.0, kl_weight=0.01)},
}


def assert_updates_raise_the_return_after_meta_training_alone(method: str, updates: int) -> None:
    collect = make_collect()
    learner = PRESETS[method](meta_batch_size=TASKS, **SLOTS[method])
    trained = untrained = learner.init(jax.random.key(0), Problem(1, 1, TASKS))
    for iteration in range(30):
        trained, _ = learner.step(jax.random.key(iteration), trained, collect)

    def returns(state: Any) -> np.ndarray:
        """Before and after the updates, `[task, 2]`."""
        fast, episodes = learner.fast_learner(state), updates * EPISODES
        found = adapt(fast, collect, Evaluation(seed=5), episodes=episodes)
        return np.asarray(found.curves.mean_return)[:, [0, updates]]

    before, after = returns(trained).T
    gain, usual = after - before, np.diff(returns(untrained))[:, 0]
    # Not adapted, no better than chance.
    assert abs(before.mean()) < SIGMAS * standard_error(before)
    assert gain.mean() > 0.6
    assert gain.mean() > SIGMAS * standard_error(gain)
    # The updates of an untrained policy do not do it.
    both = np.hypot(standard_error(gain), standard_error(usual))
    assert gain.mean() - usual.mean() > SIGMAS * both
    assert usual.mean() < 0.35


def standard_error(values: np.ndarray) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values)))
