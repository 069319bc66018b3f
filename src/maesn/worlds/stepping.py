"""The one step machine: whatever moves episodes outside of compiled programs, a step at a time.

A host world plays whole episodes with it, and the Gymnasium faces of the library step it from
outside. What differs between MuJoCo, JAX and environments of others is hidden here.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import contextmanager
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from maesn.axes import HostReadings
from maesn.envs.base import AbstractMujocoEnv, AbstractPureEnv, AnyEnv
from maesn.physics import AbstractSimulator, NativeSimulator, PhysicsError
from maesn.physics.base import ModelFields
from maesn.physics.base import Readings as SimulatorReadings
from maesn.worlds.base import SimulationFailure

Rows = Int[np.ndarray, " row"]


class AbstractStepper(ABC):
    """Episodes of one environment that are moved together."""

    max_simulations: int | None = None
    """Largest number of them; None for any number."""

    @abstractmethod
    def begin(self, start: Any, tasks: Any, rows: Rows | None = None) -> HostReadings:
        """Begin episodes.

        Args:
            start: the starts that `env.start` returns, stacked over `simulation`.
            tasks: the tasks, stacked; equally many simulations in a row have each.
            rows: indices, ascending, of the simulations that begin anew; the others stay where they
                are. None for all, as many as there are starts.

        Returns:
            The readings of all simulations.

        Raises:
            SimulationFailure: one of them cannot begin.
        """

    @abstractmethod
    def step(
        self,
        control: Float[np.ndarray, "simulation control"],
        ended: Bool[np.ndarray, " simulation"],
    ) -> HostReadings:
        """Advance all simulations by one control step.

        Args:
            control: what `env.control` returns.
            ended: simulations whose episode is over. What happens to them means nothing.

        Returns:
            The readings of all simulations.

        Raises:
            SimulationFailure: one that counts cannot go on.
        """

    def draws(self, task: Any) -> bool:
        """Return whether the environments draw themselves: those of others may."""
        return False

    def pictures(self, count: int) -> list[UInt8[np.ndarray, "height width 3"]]:
        """Return what the first simulations draw of their present states."""
        raise NotImplementedError

    @abstractmethod
    def close(self) -> None:
        """Stop threads and processes; beginning again would start them anew."""


class SimulatorStepper(AbstractStepper):
    """Moves an environment of the library's own kinds.

    Simulators are kept open, one for each number of simulations that has begun.
    """

    def __init__(self, open_one: Callable[[int], AbstractSimulator]) -> None:
        self._open_one = open_one
        self._simulators: dict[int, AbstractSimulator] = {}
        self._current: AbstractSimulator | None = None

    def begin(self, start: Any, tasks: Any, rows: Rows | None = None) -> HostReadings:
        qpos, qvel, fields = jax.tree.map(np.asarray, tuple(start))
        if rows is None:
            self._current = self._simulators.get(len(qpos)) or self._open_one(len(qpos))
            self._simulators[len(qpos)] = self._current
        with _naming():
            return self._open().reset(qpos, qvel, fields, rows)

    def step(
        self,
        control: Float[np.ndarray, "simulation control"],
        ended: Bool[np.ndarray, " simulation"],
    ) -> HostReadings:
        with _naming():
            return self._open().step(control, abandoned=ended)

    def close(self) -> None:
        for simulator in self._simulators.values():
            simulator.close()
        self._simulators, self._current = {}, None

    def _open(self) -> AbstractSimulator:
        if self._current is None:
            raise RuntimeError("there is no episode to be stepped: begin one, or make a new one")
        return self._current


@contextmanager
def _naming() -> Any:
    try:
        yield
    except PhysicsError as error:
        raise SimulationFailure(error.simulations[0], error.reason) from error


def native_simulator(
    env: AbstractMujocoEnv[Any], num_simulations: int, num_threads: int = 0
) -> NativeSimulator:
    """Return the MuJoCo engine with the environment's own model and settings."""
    return NativeSimulator(
        env.model,
        num_simulations,
        readings=env.readings,
        frame_skip=env.frame_skip,
        num_threads=num_threads,
        nonfinite=env.nonfinite,
    )


class DeviceSimulator(AbstractSimulator):
    """Moves an `AbstractPureEnv` step by step, in single precision as `DeviceWorld` does."""

    def __init__(
        self, env: AbstractPureEnv[Any], num_simulations: int, num_threads: int = 0
    ) -> None:
        self._env = env
        self._num_simulations = num_simulations
        self._state: dict[str, np.ndarray] = {}

    @property
    def num_simulations(self) -> int:
        return self._num_simulations

    def reset(
        self,
        qpos: Float[np.ndarray, "row qpos"],
        qvel: Float[np.ndarray, "row qvel"],
        model_fields: ModelFields | None = None,
        simulations: Int[np.ndarray, " row"] | None = None,
    ) -> SimulatorReadings:
        """There is no model, so `model_fields` must be empty."""
        if model_fields:
            raise ValueError(
                f"`model_fields` must be empty for `{self._env.name}`, which has no MuJoCo model, "
                f"got {', '.join(model_fields)}: move the dynamics into `advance`"
            )
        for name, rows in (("qpos", qpos), ("qvel", qvel)):
            if simulations is None:
                self._state[name] = np.array(rows, np.float32)
            else:
                self._state[name][simulations] = rows
        return self._read()

    def step(
        self,
        control: Float[np.ndarray, "simulation control"],
        abandoned: Bool[np.ndarray, " simulation"] | None = None,
    ) -> SimulatorReadings:
        """JAX raises no errors of its own."""
        if not self._state:
            raise RuntimeError("the simulator has no state: make a new one, or `reset` it")
        bad = ~np.isfinite(control).all(axis=1)
        if abandoned is not None:
            bad &= ~abandoned
        if bad.any():
            raise PhysicsError(np.flatnonzero(bad).tolist(), "the control is not finite")
        moved = _advance(self._env, self._state, control.astype(np.float32))
        self._state = {name: np.array(value) for name, value in moved.items()}
        return self._read()

    def close(self) -> None:
        self._state = {}

    def _read(self) -> SimulatorReadings:
        return {name: value.astype(np.float64) for name, value in self._state.items()}


@partial(jax.jit, static_argnums=0)
def _advance(
    env: AbstractPureEnv[Any], readings: dict[str, Array], control: Array
) -> dict[str, Array]:
    return jax.vmap(env.advance)(readings, control)


def open_simulator(env: AnyEnv, num_simulations: int, num_threads: int = 0) -> AbstractSimulator:
    """Return what moves states of an environment of the library's own kinds.

    Args:
        env: decides the engine: MuJoCo on the host, or JAX.
        num_simulations: how many simulations move together.
        num_threads: threads of the MuJoCo engine; 0 means one for each CPU.

    Raises:
        ValueError: the environment has no such states.
    """
    if isinstance(env, AbstractMujocoEnv):
        return native_simulator(env, num_simulations, num_threads)
    if isinstance(env, AbstractPureEnv):
        return DeviceSimulator(env, num_simulations)
    raise ValueError(
        f"`env` must be an environment of MuJoCo or JAX, but `{env.name}` is moved by "
        f"{env.engine}: step the environment that it was made from."
    )
