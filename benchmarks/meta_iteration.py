"""Wall time of a whole meta-iteration, as a multiple of what the physics alone takes.

    python benchmarks/meta_iteration.py --family wheeled

The meta-iteration is everything that training does: both collections, advantages, inner update,
and the outer step, whose tasks cores share as in `maesn train`. The physics alone is that of the
collections, again: see `bare_physics.py`. Both are timed in turn in one process, so that what else
the machine does falls on both. Compilation is excluded and reported apart.
"""

import resource
import time
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro
from bare_physics import BarePhysics, Recorder

from maesn.envs import AbstractMujocoEnv
from maesn.envs.sources import resolve_family
from maesn.learners import PRESETS, AbstractMetaLearner, Problem
from maesn.numerics.devices import request_devices, sharing
from maesn.worlds import make_world
from maesn.worlds.collector import Collector


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    family: str = "wheeled"
    """A family that is moved by the MuJoCo engine; your own as `module:name`."""
    method: str = "maesn"
    """Preset of the learner."""
    meta_batch_size: int = 20
    """Tasks per meta-iteration."""
    episodes_per_task: int = 20
    """Episodes per task and collection."""
    iterations: int = 15
    """Timed meta-iterations; the median counts."""
    first_iteration: int = 0
    """Number of the first of them: methods that are trained in stages do more later."""
    num_threads: int = 0
    """Threads of the engine; 0 for all cores."""


@dataclass(frozen=True)
class Times:
    """Seconds of meta-iterations."""

    first: float
    """Of the first one, with all that is compiled for it, or found in the cache."""
    whole: np.ndarray
    """Of each timed one."""
    collecting: np.ndarray
    """Of its collections."""
    bare: np.ndarray
    """Of the physics of these collections alone."""
    steps: int
    """Steps of all simulations in the last of them, those after an early end included."""

    @property
    def ratio(self) -> float:
        """Median of whole meta-iterations divided by their physics."""
        return float(np.median(self.whole / self.bare))


def measure(settings: Settings, learner: AbstractMetaLearner[Any, Any] | None = None) -> Times:
    """Time meta-iterations and the bare engine in turn.

    Args:
        settings: what is timed.
        learner: the learner instead of `settings.method` with `settings.meta_batch_size` tasks.
    """
    request_devices(None)
    chosen = learner or PRESETS[settings.method](meta_batch_size=settings.meta_batch_size)
    with sharing(None, chosen.tasks_for_cores):
        return _measured(settings, chosen)


def _measured(settings: Settings, learner: AbstractMetaLearner[Any, Any]) -> Times:
    family = resolve_family(settings.family)
    env = family.make_env(reward_kind="dense")
    assert isinstance(env, AbstractMujocoEnv), f"{settings.family} does not run on MuJoCo"
    world = make_world(env, family.task_set("training"), num_threads=settings.num_threads)
    collect = Recorder(Collector(world, settings.episodes_per_task))
    sizes = env.observation_size, env.action_size, collect.num_tasks
    problem = Problem(*sizes, episodes_per_task=settings.episodes_per_task, horizon=env.horizon)
    state = learner.init(jax.random.key(0), problem)
    state = eqx.tree_at(lambda s: s.iteration, state, jnp.asarray(settings.first_iteration))
    begin = time.perf_counter()
    state, _ = jax.block_until_ready(learner.step(jax.random.key(1), state, collect))
    first = time.perf_counter() - begin

    num_simulations = len(collect.played()[0].qpos)
    physics = BarePhysics(env, num_simulations, settings.num_threads)
    whole, collecting, bare = [], [], []
    for iteration in range(settings.iterations):
        collect.clear()
        begin = time.perf_counter()
        state, _ = jax.block_until_ready(
            learner.step(jax.random.key(2 + iteration), state, collect)
        )
        whole.append(time.perf_counter() - begin)
        collecting.append(collect.seconds)
        bare.append(physics.timed(collect.played()))
    world.close()
    return Times(first, *map(np.array, (whole, collecting, bare)), collect.steps)


def peak_memory() -> float:
    """Return the most memory that this process has taken, in GiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def report(settings: Settings, times: Times) -> None:
    """Print where the time goes."""
    whole, collecting, bare = times.whole, times.collecting, times.bare
    physics = np.median(bare)
    steps = settings.meta_batch_size * settings.episodes_per_task
    rows = {
        "first meta-iteration (with compilation)": times.first,
        "meta-iteration": np.median(whole),
        "  collections": np.median(collecting),
        "    physics alone": physics,
        "    policies, records, rewards": np.median(collecting - bare),
        "  advantages, inner update, outer step": np.median(whole - collecting),
    }
    print(
        f"{settings.method} on {settings.family}, {settings.meta_batch_size} tasks x "
        f"{settings.episodes_per_task} episodes ({steps} simulations), median of "
        f"{settings.iterations}"
    )
    for name, seconds in rows.items():
        print(f"{name:42s} {seconds:7.3f} s  {seconds / physics:6.2f} x physics")
    print(f"peak memory: {peak_memory():.2f} GiB")
    print(f"rate: {times.steps / np.median(whole):,.0f} steps/s")
    print(f"ratio: {times.ratio:.2f}")


def main(settings: Settings) -> None:
    """Time meta-iterations, and print where the time goes."""
    report(settings, measure(settings))


if __name__ == "__main__":
    main(tyro.cli(Settings))
