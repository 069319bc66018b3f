"""Pictures of an environment's states, with the goal and the way that led there."""

import os
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from maesn.axes import HostReadings, Readings
from maesn.envs.base import AbstractMujocoEnv, AnyEnv
from maesn.physics import Renderer, RenderingError, View, footprint

# The model that stands for whatever moves on a plane without MuJoCo.
_BALL = "point"


class Scene:
    """Draws the states of one environment.

    What MuJoCo moves is drawn as its model; everything else as a ball where `env.position` says.

    Args:
        env: whose states.
        view: what the camera must see.
        width: of the pictures, in pixels.
        height: of the pictures, in pixels.

    Raises:
        RenderingError: the system has no library to draw with, or the environment no planar
            position.
    """

    def __init__(self, env: AnyEnv, view: View, width: int = 320, height: int = 240) -> None:
        if not env.planar:
            raise RenderingError(
                f"`{env.name}` cannot be drawn: it does not say where in a plane its agent "
                "(`position`) and the goal of a task (`goal`) are; define both if there are such."
            )
        self.env = env
        self._renderer = Renderer(_model(env), view, width, height)

    def draw(
        self,
        readings: HostReadings,
        task: Any,
        trail: Float[np.ndarray, "point 2"] | None = None,
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Return a picture of one state.

        Args:
            readings: of that state.
            task: whose goal is shown, and the way to it that is left.
            trail: positions, in metres, that are joined by a line; None for no line.
        """
        position, judged, goal = jax.tree.map(np.asarray, _marks(self.env, readings, task))
        pose = readings["qpos"] if isinstance(self.env, AbstractMujocoEnv) else position
        return self._renderer.draw(np.asarray(pose), goal, self.env.sparse_radius, judged, trail)

    def close(self) -> None:
        """Give the memory of the drawing library back; may be called twice."""
        self._renderer.close()


def places(env: AnyEnv, readings: Readings | HostReadings) -> Float[np.ndarray, "state 2"]:
    """Return where the agent is in each state, in metres, from readings `[state, ...]`."""
    return np.asarray(_positions(env, readings))


@partial(jax.jit, static_argnums=0)
def _positions(env: AnyEnv, readings: dict[str, Array]) -> Float[Array, "state 2"]:
    return jax.vmap(lambda state: env.position(env.observe(state)))(readings)


@partial(jax.jit, static_argnums=0)
def _marks(env: AnyEnv, readings: dict[str, Array], task: Any) -> tuple[Array, Array, Array]:
    position = env.position(env.observe(readings))
    return position, env.judged_position(readings, task), env.goal(jax.tree.map(jnp.asarray, task))


def arena(env: AnyEnv, tasks: Any, readings: Readings | HostReadings) -> View:
    """Return a view of goals, and of all that moves in some states.

    Args:
        env: says where the goals are.
        tasks: whose goals; a pytree of arrays with a leading `row` axis.
        readings: of the states, `[state, ...]` each.
    """
    goals = np.asarray(jax.vmap(env.goal)(jax.tree.map(jnp.asarray, tasks)))
    states = readings["qpos"] if isinstance(env, AbstractMujocoEnv) else places(env, readings)
    covered = footprint(_model(env), np.asarray(states))
    lower = np.minimum(goals.min(axis=0) - env.sparse_radius, covered.lower)
    upper = np.maximum(goals.max(axis=0) + env.sparse_radius, covered.upper)
    return View((float(lower[0]), float(lower[1])), (float(upper[0]), float(upper[1])))


def _model(env: AnyEnv) -> str | os.PathLike[str]:
    if not isinstance(env, AbstractMujocoEnv):
        return _BALL
    if "qpos" not in env.readings:
        raise RenderingError(
            f"`{env.name}` cannot be drawn: its `readings` must include 'qpos', got "
            f"{', '.join(env.readings)}."
        )
    return env.model
