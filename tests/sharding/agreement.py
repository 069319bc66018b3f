"""Compare meta-iterations over several virtual devices with those on one device.

    python tests/sharding/agreement.py METHOD FAMILY ITERATIONS [same]

Prints, for each number of devices, the largest deviation of state and information, relative to the
largest number of each array. With `same` all devices learn from the same episodes.
"""

import json
import sys
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from maesn.envs.sources import resolve_family
from maesn.experience.episodes import Episodes
from maesn.learners import PRESETS, GradientMetaLearner, Problem
from maesn.numerics.mesh import sharing_tasks
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

DEVICES = (1, 2, 4)
# Conjugate gradients enlarge rounding, tenfold to a thousandfold in each step
# (docs/howto/cluster.md).
CG_STEPS = 5
# A sum that cancels, such as the mean of standardised advantages, is rounding alone.
SMALLEST = 1e-9


class Replay(Collector):
    """Plays each batch once, and returns the same episodes when it is asked again."""

    position = 0

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._played: list[Episodes] = []

    def __call__(self, *arguments: Any, **named: Any) -> Episodes:
        if self.position == len(self._played):
            self._played.append(super().__call__(*arguments, **named))
        self.position += 1
        return self._played[self.position - 1]


def numbers(tree: Any) -> dict[str, np.ndarray]:
    """All arrays by their paths."""
    found = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path): np.asarray(x, dtype=float) for path, x in found}


def deviations(reference: Any, other: Any) -> dict[str, float]:
    """The largest deviation of each array, relative to its largest number."""
    first, second = numbers(reference), numbers(other)
    return {
        name: float(np.abs(x - second[name]).max() / max(np.abs(x).max(), SMALLEST))
        for name, x in first.items()
        if x.size
    }


def small(method: str) -> Any:
    """A learner of eight tasks, a multiple of all numbers of devices."""
    learner = PRESETS[method](meta_batch_size=8)
    if isinstance(learner, GradientMetaLearner):
        region = replace(learner.outer.trust_region, cg_steps=CG_STEPS)
        return replace(learner, outer=replace(learner.outer, trust_region=region))
    return learner


def outcomes(method: str, family: str, iterations: int, *, same: bool) -> dict[int, Any]:
    """State and information after some iterations, by number of devices."""
    found = resolve_family(family)
    env = found.make_env(reward_kind="dense")
    world = make_world(env, found.task_set("training"), num_threads=1)
    learner, collect = small(method), (Replay if same else Collector)(world, 5)
    results = {}
    for number in DEVICES:
        if isinstance(collect, Replay):
            collect.position = 0
        with sharing_tasks(jax.devices()[:number]):
            sizes = env.observation_size, env.action_size, collect.num_tasks
            state, info = learner.init(jax.random.key(0), Problem(*sizes)), None
            for iteration in range(iterations):
                key = jax.random.key(iteration)
                state, info = learner.step(key, state, collect)
        results[number] = state, info
    world.close()
    return results


def main() -> None:
    method, family, iterations, *same = sys.argv[1:]
    found = outcomes(method, family, int(iterations), same=bool(same))
    worst = {number: deviations(found[1], found[number]) for number in DEVICES[1:]}
    print(json.dumps(worst))


if __name__ == "__main__":
    jax.config.update("jax_num_cpu_devices", max(DEVICES))
    jax.config.update("jax_enable_x64", True)
    main()
