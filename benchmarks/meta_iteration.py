"""Wall time of a whole meta-iteration, as a multiple of what the physics alone takes.

    python benchmarks/meta_iteration.py --family wheeled

The meta-iteration is everything that training does: both collections, advantages, inner update,
and the outer step. The physics alone is `mujoco.batch.Batch`, called just as the collections call
it: the same resets and steps, the same number of simulations and threads, the same readings copied
out, driven by the controls that the collections used. Both are timed in turn in one process, so
that what else the machine does falls on both. Compilation is excluded and reported apart.
"""

import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import mujoco
import numpy as np
import tyro
from mujoco.batch import Batch

from maesn.envs import AbstractMujocoEnv, find_family
from maesn.episodes import Episodes
from maesn.learners import PRESETS
from maesn.physics import load_model
from maesn.rollout import Collector
from maesn.worlds import make_world


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    family: str = "wheeled"
    """A family that is moved by the MuJoCo engine."""
    method: str = "maesn"
    """Preset of the learner."""
    meta_batch_size: int = 20
    """Tasks per meta-iteration."""
    episodes_per_task: int = 20
    """Episodes per task and collection."""
    iterations: int = 15
    """Timed meta-iterations; the median counts."""
    num_threads: int = 0
    """Threads of the engine; 0 for all cores."""


class Recorder:
    """Passes calls on to a collector, and keeps its batches and the time that they took."""

    def __init__(self, collector: Collector) -> None:
        self._collector = collector
        self.seconds = 0.0
        self.batches: list[Episodes] = []

    @property
    def num_tasks(self) -> int:
        return self._collector.num_tasks

    def __call__(self, *arguments: Any) -> Episodes:
        start = time.perf_counter()
        episodes = jax.block_until_ready(self._collector(*arguments))
        self.seconds += time.perf_counter() - start
        self.batches.append(episodes)
        return episodes


def bare_physics(env: AbstractMujocoEnv[Any], num_simulations: int, num_threads: int) -> Callable:
    """Return a function that plays one collection's controls on the engine alone."""
    batch = Batch(load_model(env.model), num_simulations, num_threads)
    qpos, qvel, ctrl = (batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
    readings = [batch.bind(name) for name in env.readings]
    derived = any(name not in ("qpos", "qvel") for name in env.readings)
    stage = (mujoco.mjtStage.mjSTAGE_ACC if derived else mujoco.mjtStage.mjSTAGE_NONE).value

    def play(start: tuple[np.ndarray, np.ndarray], controls: np.ndarray) -> None:
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        qpos[...], qvel[...] = start
        if derived:
            batch.forward()
        for control in controls:
            ctrl[...] = control
            batch.step(stage=stage)
            for reading in readings:
                reading.copy()

    return play


def controls_of(env: AbstractMujocoEnv[Any], episodes: Episodes) -> np.ndarray:
    """Return the controls of a collection as `[time, simulation, control]`."""
    controls = jax.vmap(jax.vmap(jax.vmap(env.control)))(episodes.action)
    return np.asarray(controls).reshape(-1, *controls.shape[2:]).swapaxes(0, 1).copy()


def main(settings: Settings) -> None:
    """Time meta-iterations and the bare engine in turn, and print their ratio."""
    family = find_family(settings.family)
    env = family.make_env(reward_kind="dense")
    assert isinstance(env, AbstractMujocoEnv), f"{settings.family} does not run on MuJoCo"
    world = make_world(env, family.task_set("training"), num_threads=settings.num_threads)
    collect = Recorder(Collector(world, settings.episodes_per_task))
    learner = PRESETS[settings.method](meta_batch_size=settings.meta_batch_size)
    state = learner.init(
        jax.random.key(0), env.observation_size, env.action_size, collect.num_tasks
    )
    begin = time.perf_counter()
    state, _ = jax.block_until_ready(learner.step(jax.random.key(1), state, collect))
    first = time.perf_counter() - begin

    num_simulations = settings.meta_batch_size * settings.episodes_per_task
    physics = bare_physics(env, num_simulations, settings.num_threads)
    whole, collecting, bare = [], [], []
    for iteration in range(settings.iterations):
        collect.seconds, collect.batches = 0.0, []
        begin = time.perf_counter()
        state, _ = jax.block_until_ready(
            learner.step(jax.random.key(2 + iteration), state, collect)
        )
        whole.append(time.perf_counter() - begin)
        collecting.append(collect.seconds)
        played = [controls_of(env, episodes) for episodes in collect.batches]
        start = start_states(env, num_simulations)
        begin = time.perf_counter()
        for controls in played:
            physics(start, controls)
        bare.append(time.perf_counter() - begin)
    report(settings, first, np.array(whole), np.array(collecting), np.array(bare))


def start_states(
    env: AbstractMujocoEnv[Any], num_simulations: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return initial states of the family's first task."""
    task = find_family(env.name).task_set("training")[0]
    keys = jax.random.split(jax.random.key(0), num_simulations)
    qpos, qvel = jax.vmap(env.initial, in_axes=(0, None))(keys, task)
    return np.asarray(qpos), np.asarray(qvel)


def report(
    settings: Settings,
    first: float,
    whole: np.ndarray,
    collecting: np.ndarray,
    bare: np.ndarray,
) -> None:
    """Print where the time goes."""
    physics = np.median(bare)
    steps = settings.meta_batch_size * settings.episodes_per_task
    rows = {
        "first meta-iteration (with compilation)": first,
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
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"peak memory: {peak:.2f} GiB")
    print(f"ratio: {np.median(whole / bare):.2f}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
