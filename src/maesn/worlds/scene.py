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

# The model that stands for whatever moves on a plane without MuJoCo, and the length in metres that
# suits the size of its ball: the plane is scaled so that what is seen is as long.
_BALL, _BALL_SCENE = "point", 5.0

# How far beyond tasks and start, in units of the extent of both, the camera follows.
_FOLLOWED = 0.15


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
        self, readings: HostReadings, task: Any, trail: Float[np.ndarray, "point 2"] | None = None
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Return a picture of one state, with the task's goal and the way to it that is left.

        A line joins the positions of the trail, in metres; None for no line.
        """
        if not self.env.planar:
            return self._renderer.draw_alone(np.asarray(readings["qpos"]))
        scale, marks = self._scale, _marks(self.env, readings, task)
        position, judged, goal = (scale * np.asarray(mark) for mark in marks)
        pose = readings["qpos"] if isinstance(self.env, AbstractMujocoEnv) else position
        return self._renderer.draw(
            np.asarray(pose),
            goal,
            scale * self.env.sparse_radius,
            judged,
            None if trail is None else scale * trail,
            ringed=not np.allclose(position, judged, atol=0.01 * scale * self.env.sparse_radius),
        )

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
    """Return a view of stacked tasks and of what moves in some states; None if they are no places.

    Who goes astray leaves the picture: it would make everything else too small to see. Readings are
    `[state, ...]`; the first state is the start of an episode.
    """
    if not env.planar:
        return None
    rows = jax.tree.map(jnp.asarray, tasks)
    goals, objects = (np.asarray(jax.vmap(f)(rows)) for f in (env.goal, env.landmarks))
    start, covered = _covered(env, jax.tree.map(lambda x: x[:1], readings)), _covered(env, readings)
    points = np.concatenate([objects.reshape(-1, 2), np.array(start)])
    low = np.minimum(goals.min(axis=0) - env.sparse_radius, points.min(axis=0))
    high = np.maximum(goals.max(axis=0) + env.sparse_radius, points.max(axis=0))
    margin = _FOLLOWED * (high - low).max()
    lower, upper = np.maximum(covered.lower, low - margin), np.minimum(covered.upper, high + margin)
    lower, upper = np.minimum(lower, low).tolist(), np.maximum(upper, high).tolist()
    return View(tuple(lower), tuple(upper))


def _covered(env: AnyEnv, readings: Readings | HostReadings) -> View:
    """Return the part of the plane that moves in some states."""
    if isinstance(env, AbstractMujocoEnv):
        return footprint(_model(env), np.asarray(readings["qpos"]))
    positions = places(env, readings)
    lower, upper = positions.min(axis=0).tolist(), positions.max(axis=0).tolist()
    return View(tuple(lower), tuple(upper))


def _model(env: AnyEnv) -> str | os.PathLike[str]:
    if not isinstance(env, AbstractMujocoEnv):
        return _BALL
    if "qpos" not in env.readings:
        raise RenderingError(
            f"`{env.name}` cannot be drawn: its `readings` must include 'qpos', got "
            f"{', '.join(env.readings)}."
        )
    return env.model
