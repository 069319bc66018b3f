"""Worlds moved by MuJoCo on an accelerator: a whole batch of episodes is one compiled scan."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from maesn.axes import Readings
from maesn.envs.base import AbstractMujocoEnv, Start
from maesn.envs.tasks import TaskSet
from maesn.physics.base import LARGEST
from maesn.physics.mjx import MjxEngine, MjxState
from maesn.worlds.base import AbstractWorld, Act, Actors, SimulationFailure, Trajectory
from maesn.worlds.device import scan_episodes
from maesn.worlds.stepping import naming_simulations

# The readings that show whether a simulation has blown up.
_STATE = ("qpos", "qvel")


class MjxWorld(AbstractWorld):
    """Plays an `AbstractMujocoEnv` on JAX's device.

    `num_threads` has no effect: JAX manages its own threads.

    Raises:
        EngineError: MJX is not installed.
        ValueError: it lacks something that the environment needs.
    """

    env: AbstractMujocoEnv[Any]

    def __init__(self, env: AbstractMujocoEnv[Any], tasks: TaskSet, num_threads: int = 0) -> None:
        self.env = env
        self.tasks = tasks
        readings = tuple(dict.fromkeys((*env.readings, *_STATE)))
        self._engine = MjxEngine(env.model, readings, env.frame_skip)
        self._initial = jax.jit(jax.vmap(self._engine.initial))

    def play(self, act: Act, actors: Actors, start: Start) -> Trajectory:
        state, first = self._reset(start)
        advance = _MjxAdvance(self._engine)
        trajectory, ended = scan_episodes(self.env, advance, act, actors, state, first)
        if self.env.nonfinite == "raise":
            failed, step, simulation = jax.device_get(_first_failure(trajectory.readings, ended))
            if failed:
                raise SimulationFailure(
                    int(simulation),
                    int(step),
                    f"control and state must stay finite and below {LARGEST:.0e} in size, and do "
                    "not: shorten the model's time step, or bound what drives it",
                )
        return trajectory

    def close(self) -> None:
        """Do nothing: there are no threads or processes but JAX's own."""

    def _reset(self, start: Start) -> tuple[MjxState, Readings]:
        fields = {name: np.asarray(values) for name, values in start.model_fields.items()}
        with naming_simulations():
            dynamics = self._engine.dynamics(fields)
        return self._initial(start.qpos, start.qvel, dynamics)


class _MjxAdvance(NamedTuple):
    """`Advance` of the engine."""

    engine: MjxEngine

    def __call__(
        self,
        state: MjxState,
        control: Float[Array, "simulation control"],
        ended: Bool[Array, " simulation"],
    ) -> tuple[MjxState, Readings]:
        # What is asked for in an episode that has ended may be NaN.
        calmed = jnp.where(ended[:, None], 0.0, control)
        return jax.vmap(self.engine.step)(state, calmed)


@jax.jit
def _first_failure(
    readings: Readings, ended: Bool[Array, "time task episode"]
) -> tuple[Bool[Array, ""], Int[Array, ""], Int[Array, ""]]:
    """Return whether a living episode has blown up, and the first step and simulation of those."""
    size = jnp.maximum(*(jnp.abs(readings[name]).max(axis=-1) for name in _STATE))
    failed = jnp.logical_not(size <= LARGEST)  # of NaN, too
    alive = jnp.logical_not(ended.reshape(ended.shape[0], -1))
    # The start belongs to the first step, whatever that makes of it.
    by_step = failed[1:].at[0].set(failed[0] | failed[1]) & alive
    step, simulation = jnp.divmod(jnp.argmax(by_step), by_step.shape[1])
    return by_step.any(), step, simulation
