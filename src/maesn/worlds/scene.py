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
from maesn.physics import Marks, Renderer, RenderingError, View

# The model that stands for whatever moves on a plane without MuJoCo, and the length in metres that
# suits the size of its ball: the plane is scaled so that what is seen is as long.
_BALL, _BALL_SCENE = "point", 5.0

# How far beyond tasks and start, in units of the extent of both, the camera sees.
_MARGIN = 0.15
_NO_TRAIL = np.zeros((0, 2))


class Scene:
    """Draws the states of one environment.

    What MuJoCo moves is drawn as its model; everything else as a ball where `env.position` says. A
    model whose tasks are no places is drawn without a goal, by its own first camera.

    Args:
        env: whose states.
        view: what the camera must see; None where tasks are no places.
        width: of the pictures, in pixels.
        height: of the pictures, in pixels.

    Raises:
        RenderingError: the system has no library to draw with, or the environment no planar
            position.
    """

    def __init__(self, env: AnyEnv, view: View | None, width: int = 320, height: int = 240) -> None:
        if not env.planar and not isinstance(env, AbstractMujocoEnv):
            raise RenderingError(
                f"`{env.name}` cannot be drawn: it does not say where in a plane its agent "
                "(`position`) and the goal of a task (`goal`) are; define both if there are such."
            )
        self.env = env
        self._scale = 1.0
        if view is not None and not isinstance(env, AbstractMujocoEnv):
            self._scale = _BALL_SCENE / float(np.ptp(view, axis=0).max())
            view = View(*((self._scale * x, self._scale * y) for x, y in view))
        self._renderer = Renderer(_model(env), view, width, height)

    def draw(
        self, readings: HostReadings, task: Any, trail: Float[np.ndarray, "point 2"] = _NO_TRAIL
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Return a picture of one state, with the task's goal and the way to it that is left.

        A line joins the positions of the trail, in metres.
        """
        env = self.env
        if not env.planar:
            return self._renderer.draw(np.asarray(readings["qpos"]))
        position, judged, goal = (
            self._scale * np.asarray(mark) for mark in _marks(env, readings, task)
        )
        pose = np.asarray(readings["qpos"]) if isinstance(env, AbstractMujocoEnv) else position
        scaled = Marks(goal, self._scale * env.sparse_radius, judged, self._scale * trail)
        return self._renderer.draw(pose, scaled)

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


def arena(env: AnyEnv, tasks: Any, readings: Readings | HostReadings) -> View | None:
    """Return a view of stacked tasks and of the start of an episode; None if they are no places.

    Who goes astray leaves the picture: it would make everything else too small to see. Readings are
    `[state, ...]`; the first state is the start.
    """
    if not env.planar:
        return None
    rows = jax.tree.map(jnp.asarray, tasks)
    goals, objects = (np.asarray(jax.vmap(f)(rows)) for f in (env.goal, env.landmarks))
    start = places(env, jax.tree.map(lambda x: x[:1], readings))
    radius = env.sparse_radius
    points = np.concatenate([goals - radius, goals + radius, objects.reshape(-1, 2), start])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _MARGIN * (high - low).max()
    return View(tuple((low - margin).tolist()), tuple((high + margin).tolist()))


def _model(env: AnyEnv) -> str | os.PathLike[str]:
    if not isinstance(env, AbstractMujocoEnv):
        return _BALL
    if "qpos" not in env.readings:
        raise RenderingError(
            f"`{env.name}` cannot be drawn: its `readings` must include 'qpos', got "
            f"{', '.join(env.readings)}."
        )
    return env.model
