"""Pictures: where camera, goal and lines are, worked out by hand; and what is said without GL."""

import ctypes.util
import os
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from pictures import assert_says_what_to_install, drawn

from maesn.physics import Marks, Renderer, RenderingError, View, load_model
from maesn.physics.rendering import _Arrangement

VIEW = View((-2.5, -0.4), (2.5, 2.6))
NOWHERE = np.zeros((0, 2))
BARE = """
<mujoco>
  <worldbody>
    <body pos="0.5 0 0"><joint type="slide" axis="1 0 0"/><geom size="0.2" mass="1"/></body>
    <geom type="plane" size="9 9 1"/>
  </worldbody>
</mujoco>
"""
FLOATING = """
<mujoco>
  <worldbody>
    <body pos="0 0 -0.7"><joint type="slide" axis="1 0 0"/><geom size="0.2" mass="1"/></body>
  </worldbody>
</mujoco>
"""
SWINGING = """
<mujoco>
  <worldbody>
    <body><joint type="hinge" axis="0 1 0"/><geom size="0.2" pos="1 0 0" mass="1"/></body>
  </worldbody>
</mujoco>
"""


def arranged(model: str | Path, view: View = VIEW, aspect: float = 1.5, **given: object) -> object:
    compiled = load_model(model)
    marks = Marks(goal=np.array([-1.0, 1.5]), radius=0.7, judged=np.zeros(2), trail=NOWHERE)
    return _Arrangement(compiled, view, aspect).of(compiled.qpos0, marks._replace(**given))


def shapes(scene: object, kind: mujoco.mjtGeom) -> list[object]:
    return [geom for geom in scene.geoms[: scene.ngeom] if geom.type == kind]


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    path = tmp_path / "bare.xml"
    path.write_text(BARE, encoding="utf-8")
    return path


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.5])
@pytest.mark.parametrize(
    "view", [VIEW, View((0.0, -3.0), (0.5, 4.0)), View((1.0, 1.0), (1.1, 1.1))]
)
def test_the_camera_sees_the_view_and_hardly_more(view: View, aspect: float) -> None:
    eye, other_eye = arranged("wheeled", view, aspect).camera
    right = np.cross(eye.forward, eye.up)
    (left, near), (far_right, far) = view
    corners = [(x, y, 0.0) for x in (left, far_right) for y in (near, far)]
    way = np.array(corners) - (eye.pos + other_eye.pos) / 2
    depth = way @ eye.forward
    slope = eye.frustum_top / eye.frustum_near
    seen = np.abs([way @ right / (depth * slope * aspect), way @ eye.up / (depth * slope)])
    assert (depth > 0).all()
    assert 0.85 < seen.max() < 1.0


def test_a_model_without_floor_and_light_gets_both(bare: Path) -> None:
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    (floor,) = shapes(arranged(FLOATING), plane)
    assert floor.pos[2] == pytest.approx(-0.7 - 0.2)
    swung = load_model(SWINGING)
    arm = _Arrangement(swung, VIEW, 1.5)
    marks = Marks(goal=np.zeros(2), radius=0.7, judged=np.zeros(2), trail=NOWHERE)
    heights = [shapes(arm.of(np.array([q]), marks), plane)[0].pos[2] for q in (0.0, 1.5)]
    assert heights[0] == heights[1]
    assert len(shapes(arranged(bare), plane)) == 1  # its own
    lit, dark = load_model("wheeled"), load_model(FLOATING)
    for model in (lit, dark):
        _Arrangement(model, VIEW, 1.0)
    assert dark.vis.headlight.diffuse[0] > load_model(FLOATING).vis.headlight.diffuse[0]
    np.testing.assert_array_equal(
        lit.vis.headlight.diffuse, load_model("wheeled").vis.headlight.diffuse
    )


@pytest.mark.parametrize("model", ["wheeled", "ant", "blockpush", "point"])
def test_the_marker_of_a_model_is_moved_to_the_goal(model: str) -> None:
    compiled = load_model(model)
    scene = arranged(model)
    sites = {
        mujoco.mj_id2name(compiled, mujoco.mjtObj.mjOBJ_SITE, geom.objid): geom
        for geom in scene.geoms[: scene.ngeom]
        # Nothing says what a line belongs to.
        if geom.objtype == mujoco.mjtObj.mjOBJ_SITE and geom.type != mujoco.mjtGeom.mjGEOM_LINE
    }
    np.testing.assert_allclose(sites["goal"].pos[:2], [-1.0, 1.5], atol=1e-6)
    np.testing.assert_allclose(sites["goal_region"].pos[:2], [-1.0, 1.5], atol=1e-6)
    np.testing.assert_allclose(sites["goal_region"].size[:2], 0.7, rtol=1e-6)


def test_a_model_without_marker_gets_one(bare: Path) -> None:
    disc = shapes(arranged(bare), mujoco.mjtGeom.mjGEOM_CYLINDER)[-1]
    np.testing.assert_allclose(disc.pos[:2], [-1.0, 1.5])
    np.testing.assert_allclose(disc.size[:2], 0.7, rtol=1e-6)


def test_lines_join_the_places_on_the_floor() -> None:
    goal, trail = np.array([3.0, 4.0]), np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    for model, floor in (("wheeled", 0.0), ("blockpush", -0.325)):
        lines = shapes(arranged(model, goal=goal, trail=trail), mujoco.mjtGeom.mjGEOM_LINE)
        # MuJoCo keeps a line as its start and its length.
        np.testing.assert_allclose([line.pos[:2] for line in lines], [[0, 0], [0, 0], [1, 0]])
        np.testing.assert_allclose([line.size[2] for line in lines], [5.0, 1.0, 2.0], rtol=1e-6)
        np.testing.assert_allclose([line.pos[2] for line in lines], floor, atol=0.03)


def test_pictures_show_the_goal_where_it_is_or_the_refusal_says_what_to_install() -> None:
    renderer = drawn(lambda: Renderer("wheeled", VIEW, 300, 200))
    if renderer is None:
        return
    places = []
    for x in (-1.5, 1.5):
        marks = Marks(np.array([x, 1.8]), 0.5, np.zeros(2), NOWHERE)
        picture = renderer.draw(np.zeros(6), marks).astype(int)
        green = (picture[..., 1] > picture[..., 0] + 40) & (picture[..., 1] > picture[..., 2])
        places.append(np.argwhere(green).mean(0))
    (up, left), (same, right) = places
    # The view is 5 m wide and has (0, 1.1) in its middle, so both goals are in the upper half.
    assert abs(up - same) < 3
    assert up < 90
    assert left == pytest.approx(150 - 80, abs=20)
    assert right == pytest.approx(150 + 80, abs=20)
    renderer.close()
    renderer.close()
    with pytest.raises(RuntimeError, match="the renderer is closed"):
        renderer.draw(np.zeros(6))


def test_without_a_library_one_sentence_names_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: None)
    for asked, why in (("off", "MUJOCO_GL is `off`"), ("", "neither EGL nor OSMesa is installed")):
        monkeypatch.setenv("MUJOCO_GL", asked)
        with pytest.raises(RenderingError, match=why) as caught:
            Renderer("wheeled", VIEW)
        assert_says_what_to_install(str(caught.value))


def test_a_wrong_variable_does_not_stop_the_physics() -> None:
    """MuJoCo itself cannot even be imported then."""
    program = (
        "from maesn.physics import NativeSimulator, Renderer, RenderingError, View\n"
        "print(NativeSimulator('wheeled', 1)._num_simulations)\n"
        "try:\n    Renderer('wheeled', View((0.0, 0.0), (1.0, 1.0)))\n"
        "except RenderingError as error:\n    print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"MUJOCO_GL": "nonsense"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.startswith("1\npictures need a library")
