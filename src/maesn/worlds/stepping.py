"""The one step machine: whatever moves episodes outside of compiled programs, a step at a time.

A host world plays whole episodes with it, and the library's Gymnasium environments step it from
outside. What differs between MuJoCo, JAX and environments of others is hidden here.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, UInt8

from maesn.axes import HostReadings
from maesn.envs.base import AbstractMujocoEnv, AbstractPureEnv, Start
from maesn.physics import NativeSimulator

Controls: TypeAlias = Float[np.ndarray, "simulation control"]
Ended: TypeAlias = Bool[np.ndarray, " simulation"]
Renderer: TypeAlias = Callable[[int], list[UInt8[np.ndarray, "height width 3"]]]
"""Returns pictures of the present states of that many simulations, the first ones."""


class AbstractStepper(ABC):
    """Episodes of one environment that are moved together."""

    max_simulations: int | None = None
    """Largest number of them; None for any number."""

    @abstractmethod
    def begin(self, start: Any, tasks: Any) -> HostReadings:
        """Begin episodes, as many as there are starts.

        Args:
            start: the starts that `env.start` returns, stacked over `simulation`.
            tasks: the tasks, stacked. Each is played by as many simulations, those of one task
                next to each other. Only environments of others ask for them.

        Returns:
            The readings of all simulations, in single precision.

        Raises:
            PhysicsError, WorkerError: one of them cannot begin.
        """

    @abstractmethod
    def step(self, control: Controls, ended: Ended) -> HostReadings:
        """Advance all simulations by one control step; return their readings in single precision.

        Args:
            control: what `env.control` returns.
            ended: simulations whose episode is over. Their readings may be anything.

        Raises:
            PhysicsError, WorkerError: one whose episode is not over cannot go on.
        """

    def renderer(self, task: Any) -> Renderer | None:
        """Return what lets the environments draw themselves, as those of others may; None if not.

        The environment is asked with the task, and any task will do.

        Raises:
            WorkerError: the environment cannot be used.
        """
        return None

    @abstractmethod
    def close(self) -> None:
        """Stop threads and processes; beginning again would start them anew."""


class NativeStepper(AbstractStepper):
    """Moves an `AbstractMujocoEnv` on threads of the MuJoCo engine; 0 means one for each CPU.

    Simulators are kept open, one for each number of simulations that has begun.
    """

    def __init__(self, env: AbstractMujocoEnv[Any], num_threads: int = 0) -> None:
        self._env = env
        self._num_threads = num_threads
        self._simulators: dict[int, NativeSimulator] = {}

    def begin(self, start: Start, tasks: Any) -> HostReadings:
        qpos, qvel, fields = jax.tree.map(np.asarray, tuple(start))
        return _single(self._simulator(len(qpos)).reset(qpos, qvel, fields))

    def step(self, control: Controls, ended: Ended) -> HostReadings:
        return _single(self._simulator(len(control)).step(control, abandoned=ended))

    def close(self) -> None:
        self._simulators = {}

    def _simulator(self, num_simulations: int) -> NativeSimulator:
        if num_simulations not in self._simulators:
            env = self._env
            self._simulators[num_simulations] = NativeSimulator(
                env.model,
                num_simulations,
                readings=env.readings,
                frame_skip=env.frame_skip,
                num_threads=self._num_threads,
                nonfinite=env.nonfinite,
            )
        return self._simulators[num_simulations]


def _single(readings: HostReadings) -> HostReadings:
    # What blew up may be finite in double precision and infinite in single.
    with np.errstate(over="ignore"):
        return {name: value.astype(np.float32) for name, value in readings.items()}


class DeviceStepper(AbstractStepper):
    """Moves an `AbstractPureEnv` step by step, in single precision as `DeviceWorld` does."""

    def __init__(self, env: AbstractPureEnv[Any]) -> None:
        self._env = env
        self._state: dict[str, np.ndarray] = {}

    def begin(self, start: Start, tasks: Any) -> HostReadings:
        readings = {"qpos": start.qpos, "qvel": start.qvel}
        self._state = {name: np.array(value, np.float32) for name, value in readings.items()}
        return self._state

    def step(self, control: Controls, ended: Ended) -> HostReadings:
        moved = _advance(self._env, self._state, control.astype(np.float32))
        self._state = {name: np.array(value) for name, value in moved.items()}
        return self._state

    def close(self) -> None:
        self._state = {}


@partial(jax.jit, static_argnums=0)
def _advance(
    env: AbstractPureEnv[Any], readings: dict[str, Array], control: Array
) -> dict[str, Array]:
    return jax.vmap(env.advance)(readings, control)
