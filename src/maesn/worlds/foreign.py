"""Worlds of foreign environments, which run in processes of their own."""

import contextlib
import logging
import os
import pickle
import weakref
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, UInt8, UInt32

from maesn.axes import HostReadings
from maesn.envs.foreign import AbstractGymnasiumEnv, task_row
from maesn.envs.tasks import TaskSet
from maesn.foreign import WorkerError, WorkerPool
from maesn.worlds.base import (
    AbstractWorld,
    Act,
    Actors,
    Decision,
    SimulationFailure,
    Trajectory,
)
from maesn.worlds.contract import EnvContractError
from maesn.worlds.host import play_on_host

logger = logging.getLogger(__name__)


def default_num_workers() -> int:
    """Return the number of CPUs that this process may use, where the system says."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _Camera(NamedTuple):
    """What to film, as `film` was asked."""

    shown: int
    stride: int
    size: tuple[int, int]


class GymnasiumWorld(AbstractWorld):
    """Plays an `AbstractGymnasiumEnv` in worker processes, which start when they are first needed.

    Whatever goes wrong, Ctrl-C included, stops all of them.
    """

    env: AbstractGymnasiumEnv

    def __init__(self, env: AbstractGymnasiumEnv, tasks: TaskSet, num_threads: int = 0) -> None:
        self.env = env
        self.tasks = tasks
        self._num_workers = num_threads or default_num_workers()
        self._pool: WorkerPool | None = None
        self._camera: _Camera | None = None
        self.pictures: list[list[UInt8[np.ndarray, "height width 3"]]] = []

    @property
    def max_simulations(self) -> int:
        return self.env.recipe.max_environments

    def play(self, act: Act, actors: Actors, start: UInt32[Array, " simulation"]) -> Trajectory:
        """Play with an `act` that the caller has compiled."""
        try:
            first = self._begin(actors, np.asarray(start))
            return play_on_host(self.env, act, actors, first, self._advance)
        except BaseException:
            self.close()
            raise

    def film(self, shown: int, stride: int, size: tuple[int, int]) -> bool:
        """Film environments whose `make_env` has set `render_mode="rgb_array"`."""
        try:
            renders = self._open().renders(pickle.dumps(task_row(self.tasks.tasks, 0)))
        except WorkerError as error:
            raise SimulationFailure(error.simulation, 0, error.reason) from error
        self._camera = _Camera(shown, stride, size) if renders else None
        return renders

    def close(self) -> None:
        if self._pool is not None:
            self._pool.close()
            self._pool = None

    def _begin(self, actors: Actors, seeds: np.ndarray) -> HostReadings:
        tasks = jax.device_get(actors.tasks)
        rows = [
            pickle.dumps(task_row(tasks, task)) for task in range(len(jax.tree.leaves(tasks)[0]))
        ]
        episodes = len(seeds) // len(rows)
        try:
            first = self._open().begin(
                [row for row in rows for _ in range(episodes)], [int(seed) for seed in seeds]
            )
            self.pictures = []
            self._take_pictures(0, len(seeds))
            return first
        except WorkerError as error:
            raise SimulationFailure(error.simulation, 0, error.reason) from error

    def _advance(self, decision: Decision, step: int) -> HostReadings:
        try:
            readings = self._open().step(np.asarray(decision.control))
            self._take_pictures(step + 1, len(decision.control))
            return readings
        except WorkerError as error:
            raise SimulationFailure(error.simulation, step, error.reason) from error

    def _take_pictures(self, time: int, num_simulations: int) -> None:
        camera = self._camera
        if camera and (time % camera.stride == 0 or time == self.env.horizon):
            shown = min(camera.shown, num_simulations)
            self.pictures.append(self._open().pictures(shown, camera.size))

    def _open(self) -> WorkerPool:
        if self._pool is None:
            self._pool = _new_pool(self.env, self._num_workers)
            # Also at the end of the program.
            weakref.finalize(self, self._pool.close)
        return self._pool


def check_hosted(env: AbstractGymnasiumEnv, task: Any) -> None:
    """Begin and step an environment once; what Gymnasium finds beyond that is a warning.

    Args:
        env: a family's environment.
        task: one of its tasks.

    Raises:
        EnvContractError: it fails, or returns what cannot be used.
    """
    row = pickle.dumps(jax.tree.map(np.asarray, task))
    middle = np.asarray(env.control(jnp.zeros(env.action_size)))
    with contextlib.closing(_new_pool(env, 1)) as pool:
        try:
            pool.begin([row], [0])
            pool.step(middle[None])
        except WorkerError as error:
            raise EnvContractError(f"`{env.name}`, task 0: {error.reason}") from error
        try:
            complaint = pool.complaint(row)
        except WorkerError as error:
            complaint = error.reason
    if complaint is not None:
        logger.warning(
            f"`{env.name}`: training can go on, but Gymnasium's `check_env` finds: {complaint}"
        )


def _new_pool(env: AbstractGymnasiumEnv, num_workers: int) -> WorkerPool:
    recipe = (env.recipe.make_env, env.reward_kind, env.interface)
    return WorkerPool(recipe, num_workers, env.recipe.time_limit)
