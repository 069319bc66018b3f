"""What playing foreign environments costs beyond the environments themselves.

    pip install -e '.[gym]'
    PYTHONPATH=examples python benchmarks/foreign.py

A collection is everything: policies, recording, rewards, and episodes as arrays. It is compared
with the same tasks, seeds and controls, played by

- workers alone: as many worker processes, of which nothing else is asked;
- workers elsewhere: the same in another interpreter, as by `--python`; the first divided by this is
  the rate of another interpreter relative to this one;
- environments alone: environments in this process, one episode after the other, their time divided
  by the number of workers. That is a bound: no process waits for another, or for memory.

All are timed in turn, so that what else the machine does falls on all. Starting processes, making
environments and compiling is excluded and reported apart.
"""

import itertools
import pickle
import statistics
import sys
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import tyro
from gymnasium import spaces

from maesn import maesn
from maesn.envs.hosted import AbstractGymnasiumEnv, task_row
from maesn.envs.sources import resolve_family
from maesn.experience.episodes import Episodes
from maesn.foreign import Readings, WorkerPool, pack_task
from maesn.learners import Problem
from maesn.worlds import AbstractWorld, Act, Actors, Trajectory, make_world
from maesn.worlds.budget import num_cpus
from maesn.worlds.collector import Collector


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
    python: str = sys.executable
    """Another interpreter that has the family's environments, or this one, treated as another."""


class Played(NamedTuple):
    """What the environments need to play a collection again."""

    tasks: list[bytes]
    """Of each simulation, pickled."""
    seeds: list[int]
    """Of each simulation."""
    controls: np.ndarray
    """`[time, simulation, control]`; 0 for episodes that have ended, as in the collection."""
    lengths: np.ndarray
    """Steps until an episode ends, `[simulation]`."""


class RecordingWorld(AbstractWorld):
    """Passes calls on to a world, and keeps how the last episodes began."""

    def __init__(self, world: AbstractWorld) -> None:
        self.env, self.tasks, self._world = world.env, world.tasks, world
        self._begun: tuple[Any, np.ndarray] | None = None

    def play(self, act: Act, actors: Actors, start: Any) -> Trajectory:
        """See `AbstractWorld.play`."""
        self._begun = actors.tasks, np.asarray(start)
        return self._world.play(act, actors, start)

    def close(self) -> None:
        """See `AbstractWorld.close`."""
        self._world.close()

    def played(self, episodes: Episodes) -> Played:
        """Return what was played last; takes a while, which no time should include."""
        assert self._begun is not None
        tasks, seeds = self._begun
        num_tasks, num_episodes = episodes.terminated.shape
        rows = [pack_task(task_row(tasks, task)) for task in range(num_tasks)]
        controls = jax.vmap(jax.vmap(jax.vmap(self.env.control)))(episodes.action)
        living = np.where(np.asarray(episodes.valid)[..., None], controls, 0.0)
        return Played(
            tasks=[row for row in rows for _ in range(num_episodes)],
            seeds=seeds.tolist(),
            controls=living.reshape(-1, *living.shape[2:]).swapaxes(0, 1).copy(),
            lengths=np.asarray(episodes.valid).sum(-1).ravel(),
        )


class WorkersAlone:
    """Worker processes that play a collection's controls, and nothing else."""

    def __init__(self, env: AbstractGymnasiumEnv, num_workers: int, python: str = "") -> None:
        how, make_env = env.recipe, env.recipe.make_env
        if python and not isinstance(make_env, str):  # which cannot be sent there
            make_env = f"{make_env.__module__}:{make_env.__qualname__}"
        spaces = env.interface.spaces
        self._pool = WorkerPool(
            make_env, env.reward_kind, spaces, num_workers, how.time_limit, python
        )

    def play(self, played: Played) -> Readings:
        """Play all episodes side by side, and return the last readings."""
        readings = self._pool.begin(played.tasks, played.seeds)
        for control in played.controls:
            readings = self._pool.step(control)
        return readings

    def close(self) -> None:
        """Stop the processes."""
        self._pool.close()


class EnvironmentsAlone:
    """Environments in this process, one for each task, made when it is first played."""

    def __init__(self, env: AbstractGymnasiumEnv) -> None:
        self._env = env
        self._envs: dict[bytes, gymnasium.Env[Any, Any]] = {}

    def play(self, played: Played) -> list[Any]:
        """Play one episode after the other, and return the last observation of each."""
        controls = played.controls.swapaxes(0, 1)
        episodes = zip(played.tasks, played.seeds, controls, played.lengths, strict=True)
        return [self._play_episode(*episode) for episode in episodes]

    def _play_episode(self, task: bytes, seed: int, controls: np.ndarray, length: int) -> Any:
        if task not in self._envs:
            self._envs[task] = self._env.recipe.make_env(pickle.loads(task), self._env.reward_kind)
        env = self._envs[task]
        observation, _ = env.reset(seed=seed)
        for control in controls[:length]:
            observation, *_ = env.step(spaces.unflatten(env.action_space, control))
        return observation

    def close(self) -> None:
        """Close the environments."""
        for env in self._envs.values():
            env.close()


class Times(NamedTuple):
    """Seconds in which the same episodes were played."""

    collection: float
    workers_alone: float
    workers_elsewhere: float
    environments_alone: float
    """Divided by the number of workers."""


@dataclass(frozen=True)
class Measurement:
    """A family's times."""

    first: Times
    """With processes, environments and programs, which are made then."""
    others: list[Times]
    num_steps: int
    """Of the last collection, over all simulations; others differ where episodes end early."""

    def seconds(self, name: str) -> float:
        """Return the median of a time."""
        return statistics.median(getattr(times, name) for times in self.others)

    def ratio(self, above: str, below: str) -> float:
        """Return the median, over collections, of one time divided by another."""
        return statistics.median(
            getattr(times, above) / getattr(times, below) for times in self.others
        )


def timed(call: Callable[[], Any]) -> tuple[float, Any]:
    """Return how long a call takes, and what it returns."""
    begin = time.perf_counter()
    result = jax.block_until_ready(call())
    return time.perf_counter() - begin, result


def measure(settings: Settings) -> Measurement:
    """Time collections of untrained policies, and the same episodes again after each."""
    family = resolve_family(settings.family)
    env, tasks = family.make_env(), family.task_set("training", settings.num_tasks)
    assert isinstance(env, AbstractGymnasiumEnv), f"{settings.family} is not a foreign family"
    learner, num_workers = maesn(), settings.num_workers or num_cpus()
    state = learner.init(
        jax.random.key(0), Problem(env.observation_size, env.action_size, len(tasks))
    )
    fast = learner.fast_learner(state)
    world = RecordingWorld(make_world(env, tasks, num_workers))
    collect = Collector(world, settings.episodes_per_task)
    workers, environments = WorkersAlone(env, num_workers), EnvironmentsAlone(env)
    elsewhere = WorkersAlone(env, num_workers, settings.python)
    times = []
    with closing(world), closing(workers), closing(elsewhere), closing(environments):
        for repetition in range(1 + settings.repetitions):
            keys = jax.random.split(jax.random.key(repetition), len(tasks))
            agents = fast.agents(fast.init(keys))
            whole, episodes = timed(partial(collect, keys, agents, jnp.arange(len(tasks))))
            played = world.played(episodes)
            pools = [workers, elsewhere][:: (-1) ** repetition]  # neither always comes first
            found = {pool: timed(partial(pool.play, played))[0] for pool in pools}
            bare, _ = timed(partial(environments.play, played))
            times.append(Times(whole, found[workers], found[elsewhere], bare / num_workers))
    return Measurement(times[0], times[1:], int(played.lengths.sum()))


def report(found: Measurement) -> None:
    """Print times, rates and ratios."""
    print(f"first collection, with processes and programs: {found.first.collection:.1f} s")
    for name in Times._fields:
        seconds = found.seconds(name)
        rate = found.num_steps / seconds
        print(f"  {name.replace('_', ' '):18s} {seconds:7.3f} s  {rate:9,.0f} steps/s")
    for above, below in itertools.combinations(Times._fields, 2):
        ratio = found.ratio(above, below)
        print(f"{above} / {below}: {ratio:.2f}".replace("_", " "))


def main(settings: Settings) -> None:
    """Time a family."""
    print(
        f"{settings.family}, {settings.num_tasks} tasks x {settings.episodes_per_task} episodes, "
        f"median of {settings.repetitions}"
    )
    report(measure(settings))


if __name__ == "__main__":
    main(tyro.cli(Settings))
