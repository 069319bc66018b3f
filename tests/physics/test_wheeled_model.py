"""The compiled wheeled robot against the numbers of the experiment's description."""

import math

import mujoco
import numpy as np
import pytest
from physics.robots import inertia_tensor, names

ROBOT = "wheeled"
TOTAL_MASS = 14.0
BOX = (0.15, 0.1, 0.046)  # half sizes
RADIUS, HALF_LENGTH = 0.1, 0.046
TRACK = 0.2  # distance of a wheel from the middle

BOX_VOLUME = 8 * math.prod(BOX)
WHEEL_VOLUME = math.pi * RADIUS**2 * 2 * HALF_LENGTH
SPHERE_VOLUME = 4 / 3 * math.pi * 0.1**3
DENSITY = TOTAL_MASS / (BOX_VOLUME + 2 * WHEEL_VOLUME + SPHERE_VOLUME)
CAR_MASS = DENSITY * BOX_VOLUME
WHEEL_MASS = DENSITY * WHEEL_VOLUME
WHEEL_SPIN = WHEEL_MASS * RADIUS**2 / 2
WHEEL_TURN = WHEEL_MASS * (3 * RADIUS**2 + (2 * HALF_LENGTH) ** 2) / 12

JOINTS = ["x", "y", "z", "yaw", "right_wheel", "left_wheel"]
GEOMS = ["floor", "car", "right_wheel", "left_wheel"]


def test_simulation_options(model: mujoco.MjModel) -> None:
    assert model.opt.timestep == 0.01
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    np.testing.assert_array_equal(model.opt.gravity, [0, 0, -9.81])
    assert model.opt.disableflags == mujoco.mjtDisableBit.mjDSBL_AUTORESET
    assert model.opt.enableflags == 0


def test_order_of_coordinates_and_parts(model: mujoco.MjModel) -> None:
    assert (model.nq, model.nv, model.nu, model.na) == (6, 6, 2, 0)
    assert names(model, mujoco.mjtObj.mjOBJ_JOINT, model.njnt) == JOINTS
    assert names(model, mujoco.mjtObj.mjOBJ_GEOM, model.ngeom) == GEOMS
    np.testing.assert_array_equal(model.qpos0, np.zeros(6))


@pytest.mark.parametrize(
    ("body", "mass", "rounded"),
    [
        ("car", CAR_MASS, 4.989),
        ("right_wheel", WHEEL_MASS, 2.612),
        ("left_wheel", WHEEL_MASS, 2.612),
        ("goal", 0.0, 0.0),
        ("world", 0.0, 0.0),
    ],
)
def test_masses(model: mujoco.MjModel, body: str, mass: float, rounded: float) -> None:
    assert model.body(body).mass[0] == pytest.approx(mass, rel=1e-12)
    assert mass == pytest.approx(rounded, abs=5e-4)


def test_moving_mass(model: mujoco.MjModel) -> None:
    assert model.body_subtreemass[0] == pytest.approx(
        TOTAL_MASS - DENSITY * SPHERE_VOLUME, rel=1e-12
    )
    assert model.body_subtreemass[0] == pytest.approx(10.21, abs=5e-3)


def test_inertia_of_the_car_is_that_of_a_uniform_box(model: mujoco.MjModel) -> None:
    a, b, c = np.square(BOX)
    expected = CAR_MASS / 3 * np.diag([b + c, a + c, a + b])
    np.testing.assert_allclose(inertia_tensor(model, "car"), expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("body", ["right_wheel", "left_wheel"])
def test_inertia_of_a_wheel_is_that_of_a_uniform_cylinder(model: mujoco.MjModel, body: str) -> None:
    expected = np.diag([WHEEL_TURN, WHEEL_SPIN, WHEEL_TURN])
    np.testing.assert_allclose(inertia_tensor(model, body), expected, rtol=1e-12, atol=1e-15)


def test_places_in_the_world(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    np.testing.assert_array_equal(model.body("car").pos, [0, 0, -0.4])
    np.testing.assert_array_equal(model.geom("car").pos, [0, 0, 0.6])
    for geom, place in {
        "floor": (0, 0, 0),
        "car": (0, 0, 0.2),
        "right_wheel": (0, -TRACK, RADIUS),
        "left_wheel": (0, TRACK, RADIUS),
    }.items():
        np.testing.assert_allclose(data.geom(geom).xpos, place, atol=1e-15)
    for wheel in ("right_wheel", "left_wheel"):
        # The wheel turns about its own middle, its axle lies along y.
        np.testing.assert_allclose(data.joint(wheel).xanchor, data.geom(wheel).xpos, atol=1e-15)
        axle = data.geom(wheel).xmat.reshape(3, 3)[:, 2]
        np.testing.assert_allclose(np.abs(axle), [0, 1, 0], atol=1e-15)


def test_sizes(model: mujoco.MjModel) -> None:
    kinds = mujoco.mjtGeom
    assert [int(kind) for kind in model.geom_type] == [
        int(kinds.mjGEOM_PLANE),
        int(kinds.mjGEOM_BOX),
        int(kinds.mjGEOM_CYLINDER),
        int(kinds.mjGEOM_CYLINDER),
    ]
    np.testing.assert_array_equal(model.geom("floor").size[:2], [40, 40])
    np.testing.assert_array_equal(model.geom("car").size, BOX)
    for wheel in ("right_wheel", "left_wheel"):
        np.testing.assert_allclose(model.geom(wheel).size[:2], [RADIUS, HALF_LENGTH], rtol=1e-12)


def test_joints(model: mujoco.MjModel) -> None:
    slide, hinge = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
    assert model.jnt_type.tolist() == [slide, slide, slide, hinge, hinge, hinge]
    x, y, z = np.eye(3)
    np.testing.assert_array_equal(model.jnt_axis, [x, y, z, z, y, y])
    assert model.jnt_limited.tolist() == [False, False, True, False, False, False]
    np.testing.assert_array_equal(model.joint("z").range, [-1, 0.03])
    np.testing.assert_array_equal(model.jnt_margin[:4], np.full(4, 0.01))
    for rates in (model.dof_damping, model.dof_armature, model.dof_frictionloss):
        np.testing.assert_array_equal(rates, np.zeros(6))
    np.testing.assert_array_equal(model.jnt_stiffness, np.zeros(6))


def test_contact_parameters(model: mujoco.MjModel) -> None:
    ones = np.ones((model.ngeom, 1))
    np.testing.assert_array_equal(model.geom_friction, ones * [0.4, 0.4, 0.4])
    np.testing.assert_array_equal(model.geom_solref, ones * [0.02, 1])
    # The last two are the engine's own: MuJoCo 1.31 knew three numbers.
    np.testing.assert_array_equal(model.geom_solimp, ones * [0, 0.8, 0.01, 0.5, 2])
    np.testing.assert_array_equal(model.geom_margin, np.zeros(model.ngeom))
    assert model.geom_condim.tolist() == [3] * model.ngeom


def test_actuators(model: mujoco.MjModel) -> None:
    joints = [model.joint(name).id for name in ("right_wheel", "left_wheel")]
    assert model.actuator_trnid[:, 0].tolist() == joints
    np.testing.assert_array_equal(model.actuator_gear, np.eye(6)[[0, 0]])
    assert model.actuator_ctrllimited.all()
    np.testing.assert_array_equal(model.actuator_ctrlrange, [[-2, 2], [-2, 2]])
    assert not model.actuator_forcelimited.any()


def test_only_the_floor_can_be_touched(model: mujoco.MjModel) -> None:
    meets = (model.geom_contype[:, None] & model.geom_conaffinity[None]) != 0
    floor = np.asarray(GEOMS) == "floor"
    robot = ~floor
    np.testing.assert_array_equal((meets | meets.T)[np.ix_(robot, robot)], False)
    np.testing.assert_array_equal((meets | meets.T)[np.ix_(robot, floor)], True)


def test_resistance_to_turning_on_the_spot(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    mass_matrix = np.zeros((6, 6))
    mujoco.mj_fullM(model, data, mass_matrix)
    box = CAR_MASS / 3 * (BOX[0] ** 2 + BOX[1] ** 2)
    expected = box + 2 * (WHEEL_TURN + WHEEL_MASS * TRACK**2)
    assert mass_matrix[3, 3] == pytest.approx(expected, rel=1e-12)
