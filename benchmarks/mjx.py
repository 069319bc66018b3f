"""Collection rate and seconds per meta-iteration of the engine `mjx`, on whatever device JAX has.

    python benchmarks/mjx.py                        all families
    python benchmarks/mjx.py --families ant --episodes-per-task 50 --meta-batch-size 40

A step is one control step of one simulation, policy and readings included, in a collection of
`meta_batch_size` x `episodes_per_task` episodes; a meta-iteration is all that training does.
Compilation is excluded and reported apart.
"""

import time
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from maesn.envs import AnyEnv, TaskSet, find_family
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import PRESETS, Problem
from maesn.worlds import MjxWorld
from maesn.worlds.collector import Collector


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    families: tuple[str, ...] = ("wheeled", "ant", "blockpush")
    """Families on a MuJoCo model."""
    meta_batch_size: int = 20
    """Tasks per meta-iteration."""
    episodes_per_task: int = 20
    """Episodes per task and collection."""
    repeats: int = 5
    """Timed collections and meta-iterations; the median counts."""


class Timed:
    """A family on the engine."""

    def __init__(self, env: AnyEnv, tasks: TaskSet, settings: Settings) -> None:
        world: Any = MjxWorld(env, tasks)
        self.collect = Collector(world, settings.episodes_per_task)
        self._learner = PRESETS["maesn"](meta_batch_size=settings.meta_batch_size)
        self._settings = settings
        self._state = self._learner.init(
            jax.random.key(0), Problem(env.observation_size, env.action_size, len(tasks))
        )

    def play(self) -> Episodes:
        """Play one collection of the untrained policies."""
        count = self._settings.meta_batch_size
        agents: Agents = (
            self._learner.fast_learner(self._state)
            .init(jax.random.split(jax.random.key(1), count))
            .agents
        )
        keys = jax.random.split(jax.random.key(2), count)
        return jax.block_until_ready(self.collect(keys, agents, jnp.arange(count)))

    def iterate(self) -> None:
        """Do one meta-iteration."""
        self._state, _ = jax.block_until_ready(
            self._learner.step(jax.random.key(3), self._state, self.collect)
        )

    def seconds(self, what: Any) -> tuple[float, float]:
        """Return the time of the first call, with compilation, and the median of later ones."""
        times = []
        for _ in range(1 + self._settings.repeats):
            begin = time.perf_counter()
            what()
            times.append(time.perf_counter() - begin)
        return times[0], float(np.median(times[1:]))


def time_family(name: str, settings: Settings) -> None:
    """Print the table of one family."""
    family = find_family(name)
    env, tasks = family.make_env(reward_kind="dense"), family.task_set("training")
    simulations = settings.meta_batch_size * settings.episodes_per_task
    print(f"\n{name}: {simulations} simulations of {env.horizon} steps")
    print(f"{'steps/s':>9s} {'collect':>8s} {'meta-it.':>8s} {'compile':>8s}")
    timed = Timed(env, tasks, settings)
    first, collecting = timed.seconds(timed.play)
    first_iteration, whole = timed.seconds(timed.iterate)
    compiling = first - collecting + first_iteration - whole
    rate = simulations * env.horizon / collecting
    print(f"{rate:9.0f} {collecting:7.2f}s {whole:7.2f}s {compiling:7.0f}s", flush=True)


def main(settings: Settings) -> None:
    """Time all families."""
    device = jax.devices()[0]
    print(f"{device.platform}: {device.device_kind}; JAX {jax.__version__}")
    for name in settings.families:
        time_family(name, settings)


if __name__ == "__main__":
    main(tyro.cli(Settings))
