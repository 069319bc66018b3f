"""What playing foreign environments costs beyond the environments themselves.

    pip install -e '.[gym]' 'gymnasium[mujoco]'
    PYTHONPATH=examples python benchmarks/foreign.py

A collection is everything: policies, recording, rewards, and episodes as arrays. It is compared
with the same tasks, seeds and controls on the same worker processes alone. Both are timed in turn,
so that what else the machine does falls on both. Starting processes, making environments and
compiling is excluded and reported apart.
"""

import pickle
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from maesn.envs.foreign import AbstractGymnasiumEnv, task_row
from maesn.episodes import Episodes
from maesn.foreign import WorkerPool
from maesn.learners import maesn
from maesn.rollout import Collector
from maesn.runs.task_sources import resolve_family
from maesn.worlds import make_world
from maesn.worlds.foreign import default_num_workers


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    family: str = "half_cheetah_velocity:family"
    """A foreign family, as `module:name`."""
    num_tasks: int = 20
    """Tasks per collection."""
    episodes_per_task: int = 5
    """Episodes per task."""
    num_workers: int = 0
    """Worker processes; 0 for one for each CPU."""
    repetitions: int = 7
    """Timed collections; the medians count."""


class Alone:
    """Worker processes that play a collection's controls, and nothing else."""

    def __init__(self, env: AbstractGymnasiumEnv, tasks: Any, num_workers: int) -> None:
        recipe = (env.recipe.make_env, env.reward_kind, env.interface)
        self._pool = WorkerPool(recipe, num_workers or default_num_workers(), 60.0)
        self._env, self._tasks = env, tasks

    def play(self, episodes: Episodes) -> float:
        """Play the controls of a collection, and return the seconds that it took."""
        controls = jax.vmap(jax.vmap(jax.vmap(self._env.control)))(episodes.action)
        num_tasks, num_episodes = controls.shape[:2]
        steps = np.asarray(controls).reshape(-1, *controls.shape[2:]).swapaxes(0, 1).copy()
        tasks = [
            pickle.dumps(task_row(self._tasks.tasks, task))
            for task in range(num_tasks)
            for _ in range(num_episodes)
        ]
        begin = time.perf_counter()
        self._pool.begin(tasks, range(len(tasks)))
        for control in steps:
            self._pool.step(control)
        return time.perf_counter() - begin

    def close(self) -> None:
        """Stop the processes."""
        self._pool.close()


def timed(call: Callable[[], Episodes]) -> tuple[float, Episodes]:
    """Return how long a collection takes, and what it has played."""
    begin = time.perf_counter()
    episodes = jax.block_until_ready(call())
    return time.perf_counter() - begin, episodes


def main(settings: Settings) -> None:
    """Time collections and workers alone in turn, and print their ratio."""
    family = resolve_family(settings.family)
    env, tasks = family.make_env(), family.task_set("training", settings.num_tasks)
    world = make_world(env, tasks, settings.num_workers)
    collect, learner = Collector(world, settings.episodes_per_task), maesn()
    index = jnp.arange(settings.num_tasks)
    state = learner.init(
        jax.random.key(0), env.observation_size, env.action_size, settings.num_tasks
    )
    keys = jax.random.split(jax.random.key(1), settings.num_tasks)
    fast = learner.fast_learner(state)
    agents = fast.agents(fast.init(keys))
    start, episodes = timed(lambda: collect(keys, agents, index))
    alone = Alone(env, tasks, settings.num_workers)
    alone.play(episodes)
    pairs = []
    for _ in range(settings.repetitions):
        whole, episodes = timed(lambda: collect(keys, agents, index))
        pairs.append((whole, alone.play(episodes)))
    world.close()
    alone.close()
    steps = int(episodes.valid.sum())
    whole, bare = (statistics.median(column) for column in zip(*pairs, strict=True))
    ratio = statistics.median(one / other for one, other in pairs)
    print(f"first collection, with processes and programs: {start:.1f} s")
    print(f"collection:    {whole:.3f} s, {steps / whole:,.0f} steps/s")
    print(f"workers alone: {bare:.3f} s, {steps / bare:,.0f} steps/s")
    print(f"{env.name} overhead: {ratio:.2f}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
