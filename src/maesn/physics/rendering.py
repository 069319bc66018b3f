"""Pictures of a model's states, drawn without a screen."""

import itertools
import math
import os
import weakref
from typing import Any, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, UInt8

from maesn.physics.graphics import open_context
from maesn.physics.loading import load_model

# The goal is green in every model, as is what the films say of episodes that reach it.
_GOAL_COLOUR = (0.16, 0.63, 0.36, 1.0)
_REGION_COLOUR = (0.16, 0.63, 0.36, 0.18)
_MATERIALS = {"goal": _GOAL_COLOUR, "reach": _REGION_COLOUR}  # of a model's own marker
_GLOW = 0.6  # without it the disc is grey in the shade
_FLOOR_COLOUR = (0.9, 0.9, 0.91, 1.0)
_TRAIL_COLOUR = (0.3, 0.05, 0.45, 1.0)
_WAY_COLOUR = (0.04, 0.04, 0.04, 1.0)
_TRAIL_WIDTH, _WAY_WIDTH = 3.0, 1.5  # pixels
# Shares of the longer side of what the camera sees.
_GOAL_SHARE, _RING_SHARE, _LINE_SHARE = 0.02, 0.035, 0.004
_RING_CORNERS = 24
_BRIGHT = 0.6  # of the light from the camera, for models that have no light of their own
_AZIMUTH = 90.0  # degrees: y points away from the viewer and x to the right, as in a plot
_ELEVATION = -62.0  # nearly a map, but the robot's shape is seen
_MARGIN = 1.06  # of what the camera sees over what it must see
_MAX_GEOMS = 10000
_SHADOWS = 1024  # side of the shadow map in pixels; larger ones are slow without a GPU


class View(NamedTuple):
    """The rectangle of the floor that the camera must see, in metres."""

    lower: tuple[float, float]
    """Least x and y."""
    upper: tuple[float, float]
    """Greatest x and y."""


def footprint(model: str | os.PathLike[str], qpos: Float[np.ndarray, "state qpos"]) -> View:
    """Return the part of the floor that the moving bodies of a model cover in some states.

    Raises as `load_model`.
    """
    compiled = load_model(model)
    data = mujoco.MjData(compiled)
    moves = compiled.body_weldid[compiled.geom_bodyid] != 0
    reach = compiled.geom_rbound[moves, None]
    boxes = []
    for state in qpos:
        data.qpos[:] = state
        mujoco.mj_kinematics(compiled, data)
        position = data.geom_xpos[moves, :2]
        boxes.append([(position - reach).min(axis=0), (position + reach).max(axis=0)])
    lower, upper = np.min(boxes, axis=0)[0].tolist(), np.max(boxes, axis=0)[1].tolist()
    return View(tuple(lower), tuple(upper))


class Renderer:
    """Draws states of one model, each with its goal and the way that led there.

    Args:
        model: as for `load_model`.
        view: what the camera must see; None for the model's own first camera.
        width: of the pictures, in pixels.
        height: of the pictures, in pixels.

    Raises:
        RenderingError: the system has no library to draw with. Else it raises as `load_model`.
    """

    def __init__(
        self, model: str | os.PathLike[str], view: View | None, width: int = 320, height: int = 240
    ) -> None:
        compiled = load_model(model)
        compiled.vis.global_.offwidth, compiled.vis.global_.offheight = width, height
        compiled.vis.quality.shadowsize = min(_SHADOWS, compiled.vis.quality.shadowsize)
        self._arrangement = _Arrangement(compiled, view, width / height)
        self._viewport = mujoco.MjrRect(0, 0, width, height)
        self._context, self._drawer = open_context(compiled, width, height)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawer)
        self._close = weakref.finalize(self, _release, self._context, self._drawer)

    def draw(
        self,
        qpos: Float[np.ndarray, " qpos"],
        goal: Float[np.ndarray, " 2"],
        radius: float,
        judged: Float[np.ndarray, " 2"],
        trail: Float[np.ndarray, "point 2"] | None = None,
        *,
        ringed: bool = False,
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Return a picture of one state.

        Positions and lengths are in metres, on the floor.

        Args:
            qpos: generalised positions.
            goal: its position.
            radius: radius of the goal region.
            judged: position of what has to reach the goal; a thin line joins the two.
            trail: positions that are joined by a line; None for no line.
            ringed: whether a ring marks what has to reach the goal.
        """
        way = np.stack([judged, goal])
        walked = way[:0] if trail is None else trail
        return self._picture(self._arrangement.of(qpos, goal, radius, way, walked, ringed=ringed))

    def draw_alone(self, qpos: Float[np.ndarray, " qpos"]) -> UInt8[np.ndarray, "height width 3"]:
        """Return a picture of one state without a goal, from its generalised positions."""
        return self._picture(self._arrangement.alone(qpos))

    def _picture(self, scene: Any) -> UInt8[np.ndarray, "height width 3"]:
        if not self._close.alive:
            raise RuntimeError("the renderer is closed: make a new one")
        self._context.make_current()
        mujoco.mjr_render(self._viewport, scene, self._drawer)
        upside_down = np.empty((self._viewport.height, self._viewport.width, 3), np.uint8)
        mujoco.mjr_readPixels(upside_down, None, self._viewport, self._drawer)
        return np.ascontiguousarray(upside_down[::-1])

    def close(self) -> None:
        """Give the memory of the drawing library back; may be called twice."""
        self._close()


class _Arrangement:
    """Puts shapes and camera where they belong; needs no library to draw with."""

    def __init__(self, model: Any, view: View | None, aspect: float) -> None:
        self._model = model
        self._data = mujoco.MjData(model)
        fovy = math.radians(model.vis.global_.fovy)
        self._camera = _own_camera(model) if view is None else _camera(view, fovy, aspect)
        self._scene = mujoco.MjvScene(model, maxgeom=_MAX_GEOMS)
        self._options = mujoco.MjvOption()
        self._side = 1.0 if view is None else float(np.ptp(view, axis=0).max())
        self._marker = _GoalMarker(model, _GOAL_SHARE * self._side)
        self._floor = _missing_floor(model, self._data)
        if not model.nlight:
            model.vis.headlight.ambient[:] = model.vis.headlight.diffuse[:] = _BRIGHT

    def of(
        self,
        qpos: np.ndarray,
        goal: np.ndarray,
        radius: float,
        way: np.ndarray,
        trail: np.ndarray,
        *,
        ringed: bool = False,
    ) -> Any:
        """Return the scene of one state with its goal."""
        self._marker.move(self._data, goal, radius)
        self.alone(qpos)
        self._marker.add_to(self._scene, goal, radius)
        if self._floor is not None:
            size, place = (10 * self._side, 10 * self._side, 0.1), (*goal, self._floor)
            _shape(self._scene, mujoco.mjtGeom.mjGEOM_PLANE, size, place, _FLOOR_COLOUR)
        height = self._marker.height(self._data) + _LINE_SHARE * self._side
        _add_line(self._scene, way, height, _WAY_WIDTH, _WAY_COLOUR)
        _add_line(self._scene, trail, height, _TRAIL_WIDTH, _TRAIL_COLOUR)
        if ringed:
            angles = np.linspace(0.0, 2 * np.pi, _RING_CORNERS + 1)
            circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
            ring = way[0] + _RING_SHARE * self._side * circle
            _add_line(self._scene, ring, height, _TRAIL_WIDTH, _GOAL_COLOUR)
        return self._scene

    def alone(self, qpos: np.ndarray) -> Any:
        """Return the scene of one state."""
        self._data.qpos[:] = qpos
        mujoco.mj_forward(self._model, self._data)
        mujoco.mjv_updateScene(
            self._model, self._data, self._options, None, self._camera,
            int(mujoco.mjtCatBit.mjCAT_ALL), self._scene,
        )  # fmt: skip
        return self._scene


def _missing_floor(model: Any, data: Any) -> float | None:
    """Return how high a floor belongs into a model that has none: at 0, or below all of it."""
    if (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any():
        return None
    mujoco.mj_kinematics(model, data)
    return float((data.geom_xpos[:, 2] - model.geom_rbound).min(initial=0.0))


class _GoalMarker:
    """The goal in a scene: the model's own, if it has a movable body `goal`, or two shapes."""

    def __init__(self, model: Any, size: float) -> None:
        for name, colour in _MATERIALS.items():
            material = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_MATERIAL, name)
            if material >= 0:
                model.mat_rgba[material] = colour
                model.mat_emission[material] = _GLOW
        self._size = size
        names = (mujoco.mjtObj.mjOBJ_BODY, "goal"), (mujoco.mjtObj.mjOBJ_SITE, "goal_region")
        body, self._region = (mujoco.mj_name2id(model, kind, name) for kind, name in names)
        self._mocap = int(model.body_mocapid[body]) if body >= 0 else -1
        self._model = model

    def move(self, data: Any, goal: np.ndarray, radius: float) -> None:
        """Move the model's own marker."""
        if self._mocap >= 0:
            data.mocap_pos[self._mocap, :2] = goal
        if self._region >= 0:
            self._model.site_size[self._region, 0] = radius

    def height(self, data: Any) -> float:
        """Return how high the floor is that the goal lies on, in metres."""
        return 0.0 if self._region < 0 else float(data.site_xpos[self._region, 2])

    def add_to(self, scene: Any, goal: np.ndarray, radius: float) -> None:
        """Add a marker to a scene of a model that has none."""
        if self._mocap >= 0:
            return
        ball, disc = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CYLINDER
        _shape(scene, ball, (self._size,) * 3, (*goal, self._size), _GOAL_COLOUR)
        _shape(scene, disc, (radius, radius, 0.001), (*goal, 0.001), _REGION_COLOUR)


def _shape(scene: Any, kind: Any, size: Any, position: Any, colour: Any) -> Any:
    geom = scene.geoms[scene.ngeom]
    values = (np.array(value, np.float64) for value in (size, position, np.eye(3).ravel()))
    mujoco.mjv_initGeom(geom, kind, *values, np.array(colour, np.float32))
    scene.ngeom += 1
    return geom


def _add_line(
    scene: Any, points: np.ndarray, height: float, width: float, colour: tuple[float, ...]
) -> None:
    kind = mujoco.mjtGeom.mjGEOM_LINE  # capsules would take longer than all the rest
    for start, end in itertools.pairwise(points):
        geom = _shape(scene, kind, np.zeros(3), np.zeros(3), colour)
        ends = (np.array([*point, height], np.float64) for point in (start, end))
        mujoco.mjv_connector(geom, kind, width, *ends)


def _camera(view: View, field_of_view: float, aspect: float) -> Any:
    """Return the nearest camera with a fixed direction that sees the whole view.

    A point at p from the middle of the view is seen if |p . right| <= depth tan(f / 2) aspect and
    |p . up| <= depth tan(f / 2), where f is the vertical field of view and depth = distance +
    p . forward. Solved for the distance, for the corners of the view.
    """
    lower, upper = np.array(view.lower), np.array(view.upper)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (*(lower + upper) / 2, 0.0)
    camera.azimuth, camera.elevation = _AZIMUTH, _ELEVATION
    half_x, half_y = _MARGIN * (upper - lower) / 2
    sine, cosine = math.sin(math.radians(-_ELEVATION)), math.cos(math.radians(-_ELEVATION))
    slope = math.tan(field_of_view / 2)
    camera.distance = max(
        max(half_x / (slope * aspect), abs(y) * sine / slope) - y * cosine
        for y in (-half_y, half_y)
    )
    return camera


def _own_camera(model: Any) -> Any:
    """Return a model's first camera, or one that sees all of it where it has none."""
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    if model.ncam:
        camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
    return camera


def _release(context: Any, drawer: Any) -> None:
    context.make_current()
    drawer.free()
    context.free()
