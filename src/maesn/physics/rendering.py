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
_BRIGHT = 0.6  # of the light from the camera, for models that have no light of their own
_TRAIL_COLOUR = (0.3, 0.05, 0.45, 1.0)
_WAY_COLOUR = (0.04, 0.04, 0.04, 1.0)
_TRAIL_WIDTH, _WAY_WIDTH = 3.0, 1.5  # pixels
_GOAL_SHARE, _LINE_SHARE = 0.02, 0.004  # of the longer side of what the camera sees
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


class Marks(NamedTuple):
    """What is drawn on the floor beside a model. Positions and lengths are in metres."""

    goal: Float[np.ndarray, " 2"]
    radius: float
    """Of the goal region."""
    judged: Float[np.ndarray, " 2"]
    """What has to reach the goal; a thin line joins the two."""
    trail: Float[np.ndarray, "point 2"]
    """Positions that are joined by a line."""


class Renderer:
    """Draws states of one model.

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
        self, qpos: Float[np.ndarray, " qpos"], marks: Marks | None = None
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Return a picture of one state, from its generalised positions."""
        if not self._close.alive:
            raise RuntimeError("the renderer is closed: make a new one")
        self._context.make_current()
        mujoco.mjr_render(self._viewport, self._arrangement.of(qpos, marks), self._drawer)
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
        self._has_floor = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any()
        mujoco.mj_kinematics(model, self._data)
        self._lowest = (self._data.geom_xpos[:, 2] - model.geom_rbound).min(initial=0.0)
        if not model.nlight:
            model.vis.headlight.ambient[:] = model.vis.headlight.diffuse[:] = _BRIGHT

    def of(self, qpos: np.ndarray, marks: Marks | None = None) -> Any:
        """Return the scene of one state."""
        if marks is not None:
            self._marker.move(self._data, marks)
        self._data.qpos[:] = qpos
        mujoco.mj_forward(self._model, self._data)
        mujoco.mjv_updateScene(
            self._model, self._data, self._options, None, self._camera,
            int(mujoco.mjtCatBit.mjCAT_ALL), self._scene,
        )  # fmt: skip
        if marks is not None:
            self._marker.add_to(self._scene, marks)
            if not self._has_floor:
                size, place = (10 * self._side, 10 * self._side, 0.1), (*marks.goal, self._lowest)
                _shape(self._scene, mujoco.mjtGeom.mjGEOM_PLANE, size, place, _FLOOR_COLOUR)
            height = self._marker.height(self._data) + _LINE_SHARE * self._side
            way = np.stack([marks.judged, marks.goal])
            _add_line(self._scene, way, height, _WAY_WIDTH, _WAY_COLOUR)
            _add_line(self._scene, marks.trail, height, _TRAIL_WIDTH, _TRAIL_COLOUR)
        return self._scene


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

    def move(self, data: Any, marks: Marks) -> None:
        """Move the model's own marker."""
        if self._mocap >= 0:
            data.mocap_pos[self._mocap, :2] = marks.goal
        if self._region >= 0:
            self._model.site_size[self._region, 0] = marks.radius

    def height(self, data: Any) -> float:
        """Return how high the floor is that the goal lies on, in metres."""
        return 0.0 if self._region < 0 else float(data.site_xpos[self._region, 2])

    def add_to(self, scene: Any, marks: Marks) -> None:
        """Add a marker to a scene of a model that has none."""
        if self._mocap >= 0:
            return
        ball, disc = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CYLINDER
        size, radius = self._size, marks.radius
        _shape(scene, ball, (size, size, size), (*marks.goal, size), _GOAL_COLOUR)
        _shape(scene, disc, (radius, radius, 0.001), (*marks.goal, 0.001), _REGION_COLOUR)


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

    A point at p from where the camera looks is seen if |p . right| <= depth tan(f / 2) aspect and
    |p . up| <= depth tan(f / 2), where f is the vertical field of view and depth = distance +
    p . forward. Solved for the corners of the view: near and far edge are at the picture's own
    edges, unless the view is so wide that the corners at the near edge decide.
    """
    (half_x, half_y), middle = _MARGIN * np.ptp(view, axis=0) / 2, np.mean(view, axis=0)
    sine, cosine = math.sin(math.radians(-_ELEVATION)), math.cos(math.radians(-_ELEVATION))
    slope = math.tan(field_of_view / 2)
    nearer = half_y * cosine * slope / sine  # than the middle, because near things look larger
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (middle[0], middle[1] - nearer, 0.0)
    camera.azimuth, camera.elevation = _AZIMUTH, _ELEVATION
    height = (half_y - nearer) * (sine / slope + cosine)
    width = half_x / (slope * aspect) + (half_y - nearer) * cosine
    camera.distance = max(height, width)
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
