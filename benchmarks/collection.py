"""Rate of collecting episodes, as a share of what the engine alone reaches.

    python benchmarks/collection.py

A collection is everything: starts, policies, physics, recording, rewards, and episodes as arrays.
The engine alone makes the same calls with the same readings on the same threads (see
`bare_physics.py`). Both are timed in turn in one process, so that what else the machine does falls
on both, and the ratio of each pair is what counts. Compilation is excluded and reported apart.
"""

import statistics
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import tyro
from bare_physics import BarePhysics, Recorder

from maesn.envs import AbstractMujocoEnv
from maesn.envs.sources import resolve_family
from maesn.learners import PRESETS, Problem
from maesn.worlds import make_world
from maesn.worlds.collector import Collector


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    families: tuple[str, ...] = ("wheeled", "ant", "blockpush")
    """Families that are moved by the MuJoCo engine; your own as `module:name`."""
    method: str = "maesn"
    """Preset of the learner whose untrained policies play."""
    num_tasks: int = 20
    """Tasks per collection."""
    episodes_per_task: int = 50
    """Episodes per task."""
    num_threads: int = 0
    """Threads of the engine; 0 for all cores."""
    repetitions: int = 9
    """Timed pairs; the medians count."""


@dataclass(frozen=True)
class Measurement:
    """One family's times, in seconds."""

    first: float
    """Of the first collection, with compilation."""
    collecting: list[float]
    """Of each timed collection."""
    bare: list[float]
    """Of the engine alone, after each."""
    num_steps: int
    """Control steps of a collection, over all simulations."""

    @property
    def ratio(self) -> float:
        """Median, over pairs, of the collection's rate divided by the engine's."""
        pairs = zip(self.bare, self.collecting, strict=True)
        return statistics.median(bare / collecting for bare, collecting in pairs)


def measure(name: str, settings: Settings) -> Measurement:
    """Time collections of a family, and the engine alone after each."""
    family = resolve_family(name)
    env, tasks = family.make_env(), family.task_set("training")
    assert isinstance(env, AbstractMujocoEnv), f"{name} does not run on MuJoCo"
    world = make_world(env, tasks, settings.num_threads)
    collect = Recorder(Collector(world, settings.episodes_per_task))
    learner = PRESETS[settings.method]()
    state = learner.init(
        jax.random.key(0), Problem(env.observation_size, env.action_size, len(tasks))
    )
    fast = learner.fast_learner(state)
    num_simulations = settings.num_tasks * settings.episodes_per_task
    physics = BarePhysics(env, num_simulations, settings.num_threads)
    collecting, bare = [], []
    for repetition in range(1 + settings.repetitions):
        keys = jax.random.split(jax.random.key(repetition), settings.num_tasks)
        agents = fast.agents(fast.init(keys))
        collect.clear()
        collect(keys, agents, jnp.arange(settings.num_tasks))
        collecting.append(collect.seconds)
        bare.append(physics.timed(collect.played()))
    world.close()
    return Measurement(collecting[0], collecting[1:], bare[1:], env.horizon * num_simulations)


def report(name: str, found: Measurement) -> None:
    """Print rates and their ratio."""
    print(f"{name}, first collection, with compilation: {found.first:.1f} s")
    for what, seconds in {"collection": found.collecting, "engine alone": found.bare}.items():
        typical = statistics.median(seconds)
        print(f"  {what:13s} {typical:7.3f} s  {found.num_steps / typical:9,.0f} steps/s")
    print(f"{name} ratio: {found.ratio:.2f}")


def main(settings: Settings) -> None:
    """Time all families."""
    print(
        f"{settings.num_tasks} tasks x {settings.episodes_per_task} episodes, median of "
        f"{settings.repetitions}"
    )
    for name in settings.families:
        report(name, measure(name, settings))


if __name__ == "__main__":
    main(tyro.cli(Settings))
