"""The physics of a collection, again, on the engine alone: what benchmarks compare with.

`mujoco.batch.Batch` is called just as a collection calls it: as many simulations on as many
threads, the same starts, dynamics and controls, the same number of resets and steps, the same
readings copied out of it. No policy is asked, nothing is checked, recorded or rewarded.
"""

import time
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np
from jaxtyping import Array, Int
from mujoco.batch import Batch

from maesn.axes import TaskKeys
from maesn.envs import AbstractMujocoEnv
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.physics import load_model
from maesn.worlds.collector import Collector


class Played(NamedTuple):
    """What the engine needs to play a collection again."""

    qpos: np.ndarray
    """Of the start, `[simulation, qpos]`."""
    qvel: np.ndarray
    model_fields: dict[str, np.ndarray]
    """What the tasks change in the dynamics, `[simulation, ...]` each."""
    controls: np.ndarray
    """`[time, simulation, control]`; 0 for episodes that have ended, as in the collection."""


class Recorder:
    """Passes calls on to a collector, and keeps what it played and the time that it took."""

    def __init__(self, collector: Collector) -> None:
        self._collector = collector
        self._batches: list[tuple[np.ndarray, Episodes, Any]] = []
        self.seconds = 0.0

    @property
    def num_tasks(self) -> int:
        """See `Collector.num_tasks`."""
        return self._collector.num_tasks

    @property
    def episodes_per_task(self) -> int:
        """See `Collector.episodes_per_task`."""
        return self._collector.episodes_per_task

    def __call__(
        self, keys: TaskKeys, agents: Agents, task_index: Int[Array, " task"], stage: int = 0
    ) -> Episodes:
        """See `Collector`."""
        begin = time.perf_counter()
        episodes, readings = jax.block_until_ready(self._collector.play(keys, agents, task_index))
        self.seconds += time.perf_counter() - begin
        start = {name: values[0] for name, values in readings.items()}
        self._batches.append((np.asarray(task_index), episodes, start))
        return episodes

    @property
    def steps(self) -> int:
        """Steps of all simulations so far, those after an early end included."""
        return sum(episodes.valid.size for _, episodes, _ in self._batches)

    def clear(self) -> None:
        """Forget all that was played so far."""
        self.seconds, self._batches = 0.0, []

    def played(self) -> list[Played]:
        """Return all that was played since then; takes a while, which no time should include."""
        world = self._collector.world
        return [_again(world.env, world.tasks[index], *rest) for index, *rest in self._batches]


def _again(env: Any, tasks: Any, episodes: Episodes, start: dict[str, np.ndarray]) -> Played:
    controls = jax.vmap(jax.vmap(jax.vmap(env.control)))(episodes.action)
    living = np.where(np.asarray(episodes.valid)[..., None], controls, 0.0)
    fields = {
        name: np.repeat(np.asarray(values), living.shape[1], axis=0)
        for name, values in jax.vmap(env.model_fields)(tasks).items()
    }
    by_time = living.reshape(-1, *living.shape[2:]).swapaxes(0, 1).copy()
    return Played(start["qpos"], start["qvel"], fields, by_time)


class BarePhysics:
    """The engine alone, with an environment's model and readings."""

    def __init__(
        self, env: AbstractMujocoEnv[Any], num_simulations: int, num_threads: int = 0
    ) -> None:
        self._batch: Any = Batch(load_model(env.model), num_simulations, num_threads)
        self._qpos, self._qvel, self._ctrl = map(self._batch.bind, ("qpos", "qvel", "ctrl"))
        self._readings = {name: self._batch.bind(name) for name in env.readings}
        self._derived = not {"qpos", "qvel"}.issuperset(env.readings)
        stage = mujoco.mjtStage.mjSTAGE_ACC if self._derived else mujoco.mjtStage.mjSTAGE_NONE
        self._step = {"nstep": env.frame_skip, "stage": int(stage)}

    def play(self, played: Played) -> dict[str, np.ndarray]:
        """Play a collection's controls, and return the last readings, `[simulation, ...]` each."""
        self._batch.reset(stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        for name, values in played.model_fields.items():
            self._batch.expand(name)[...] = values
        if played.model_fields:
            self._batch.set_const()
        self._qpos[...], self._qvel[...] = played.qpos, played.qvel
        if self._derived:
            self._batch.forward()
        last = self._read()
        for control in played.controls:
            self._ctrl[...] = control
            self._batch.step(**self._step)
            last = self._read()
        return last

    def timed(self, collections: list[Played]) -> float:
        """Play collections one after the other, and return the seconds that it takes."""
        begin = time.perf_counter()
        for played in collections:
            self.play(played)
        return time.perf_counter() - begin

    def _read(self) -> dict[str, np.ndarray]:
        return {name: reading.copy() for name, reading in self._readings.items()}
