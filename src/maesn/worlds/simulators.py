"""Simulators of any environment: its states, moved by one control step at a time.

A world plays whole episodes. A Gymnasium environment is stepped from outside and needs the same
motion in single steps.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from maesn.envs.base import AbstractMujocoEnv, AbstractPureEnv, AnyEnv
from maesn.physics import AbstractSimulator, NativeSimulator, PhysicsError
from maesn.physics.base import ModelFields
from maesn.physics.base import Readings as SimulatorReadings


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


# Engine of an environment -> what moves single states of it.
_SIMULATORS: dict[str, Callable[..., AbstractSimulator]] = {
    "jax": DeviceSimulator,
    "mujoco.batch": native_simulator,
}


def open_simulator(env: AnyEnv, num_simulations: int, num_threads: int = 0) -> AbstractSimulator:
    """Return what moves this kind of environment.

    Args:
        env: decides the engine: MuJoCo on the host, or JAX.
        num_simulations: how many simulations move together.
        num_threads: threads of the MuJoCo engine; 0 means one for each CPU.

    Raises:
        ValueError: the environment's world cannot be moved in single steps.
    """
    if env.engine not in _SIMULATORS:
        raise ValueError(
            f"`env` must be moved by one of {', '.join(_SIMULATORS)}, but `{env.name}` is moved by "
            f"{env.engine}: step the environment that it was made from."
        )
    return _SIMULATORS[env.engine](env, num_simulations, num_threads)
