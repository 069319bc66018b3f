"""The compiled block pushing against the numbers of the experiment's description."""

import math

import mujoco
import numpy as np
import pytest
from physics.robots import names

ROBOT = "blockpush"
BLOCKS = [f"block_{index}" for index in range(5)]
CAPSULES = ["crossbar", "right_arm", "left_arm"]
TIPS = ["right_tip", "left_tip"]
RADIUS, TIP_RADIUS = 0.02, 0.01
LENGTHS = {"crossbar": 0.2, "right_arm": 0.1, "left_arm": 0.1}
BLOCK = (0.03, 0.03, 0.05)  # half sizes
GRIPPER_DENSITY, BLOCK_DENSITY = 10.0, 0.0005


def ball(radius: float) -> float:
    return 4 / 3 * math.pi * radius**3


MASSES = {
    name: GRIPPER_DENSITY * (math.pi * RADIUS**2 * length + ball(RADIUS))
    for name, length in LENGTHS.items()
} | {name: GRIPPER_DENSITY * ball(TIP_RADIUS) for name in TIPS}
GRIPPER_MASS = sum(MASSES.values())
BLOCK_MASS = BLOCK_DENSITY * 8 * math.prod(BLOCK)


def moving_geoms() -> list[str]:
    return [*CAPSULES, *TIPS, *BLOCKS]


def test_simulation_options(model: mujoco.MjModel) -> None:
    assert model.opt.timestep == 0.01
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    assert model.opt.iterations == 20
    np.testing.assert_array_equal(model.opt.gravity, np.zeros(3))
    assert model.opt.disableflags == mujoco.mjtDisableBit.mjDSBL_AUTORESET
    assert model.opt.enableflags == 0


def test_order_of_coordinates_and_parts(model: mujoco.MjModel) -> None:
    assert (model.nq, model.nv, model.nu, model.na) == (13, 13, 3, 0)
    joints = ["x", "y", "angle"] + [f"{block}_{axis}" for block in BLOCKS for axis in "xy"]
    assert names(model, mujoco.mjtObj.mjOBJ_JOINT, model.njnt) == joints
    assert names(model, mujoco.mjtObj.mjOBJ_GEOM, model.ngeom) == ["table", *moving_geoms()]
    assert names(model, mujoco.mjtObj.mjOBJ_BODY, model.nbody)[2:] == ["gripper", *BLOCKS]
    np.testing.assert_array_equal(model.qpos0, np.zeros(13))


def test_masses(model: mujoco.MjModel) -> None:
    assert model.body("gripper").mass[0] == pytest.approx(GRIPPER_MASS, rel=1e-12)
    assert pytest.approx(0.006, abs=5e-4) == GRIPPER_MASS
    assert pytest.approx(1.8e-7, rel=1e-12) == BLOCK_MASS
    for block in BLOCKS:
        assert model.body(block).mass[0] == pytest.approx(BLOCK_MASS, rel=1e-12)
    moving = GRIPPER_MASS + 5 * BLOCK_MASS  # neither the table nor the goal has any mass
    assert model.body_subtreemass[0] == pytest.approx(moving, rel=1e-12)


def test_inertia_of_a_block_is_that_of_a_uniform_box(model: mujoco.MjModel) -> None:
    a, b, c = np.square(BLOCK)
    for block in BLOCKS:
        expected = BLOCK_MASS / 3 * np.array([b + c, a + c, a + b])
        np.testing.assert_allclose(model.body(block).inertia, expected, rtol=1e-12)


def capsule_inertia(length: float) -> tuple[float, float]:
    """Of a uniform cylinder with two half balls: about its axis, and across it."""
    cylinder = GRIPPER_DENSITY * math.pi * RADIUS**2 * length
    ends = GRIPPER_DENSITY * ball(RADIUS)
    along = cylinder * RADIUS**2 / 2 + ends * 2 * RADIUS**2 / 5
    across = cylinder * (length**2 / 12 + RADIUS**2 / 4) + ends * (
        2 * RADIUS**2 / 5 + length**2 / 4 + 3 * length * RADIUS / 8
    )
    return along, across


def test_inertia_of_the_gripper_about_its_middle(model: mujoco.MjModel) -> None:
    # About the vertical axis through the origin of the body: each part lies level, so that it
    # turns across its own axis, plus its mass times the squared distance of its middle.
    parts = {"crossbar": 0.0, "right_arm": 0.05**2 + 0.1**2, "left_arm": 0.05**2 + 0.1**2}
    about_origin = sum(
        capsule_inertia(LENGTHS[name])[1] + MASSES[name] * squared
        for name, squared in parts.items()
    )
    for tip in TIPS:
        about_origin += MASSES[tip] * (2 / 5 * TIP_RADIUS**2 + 0.1**2 + 0.1**2)
    mass_matrix = np.zeros((13, 13))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass_matrix)
    assert mass_matrix[2, 2] == pytest.approx(about_origin + 0.04, rel=1e-12)
    np.testing.assert_allclose(mass_matrix[[0, 1], [0, 1]], GRIPPER_MASS + 0.04, rtol=1e-12)
    np.testing.assert_allclose(np.diag(mass_matrix)[3:], BLOCK_MASS + 0.04, rtol=1e-12)


def test_places_in_the_world(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    np.testing.assert_array_equal(data.body("gripper").xpos, [0, 0, -0.263])
    np.testing.assert_array_equal(data.site("arm").xpos, [0.02, 0, -0.263])
    for index, block in enumerate(BLOCKS):
        home = [0.2 * (index + 1), 0, -0.275]
        np.testing.assert_allclose(data.geom(block).xpos, home, atol=1e-15)
    middles = {"crossbar": (0, 0), "right_arm": (0.05, -0.1), "left_arm": (0.05, 0.1)}
    for name, place in (middles | {"right_tip": (0.1, -0.1), "left_tip": (0.1, 0.1)}).items():
        np.testing.assert_allclose(data.geom(name).xpos, [*place, -0.263], atol=1e-15)
    for name, axis in {
        "crossbar": (0, 1, 0),
        "right_arm": (1, 0, 0),
        "left_arm": (1, 0, 0),
    }.items():
        along = data.geom(name).xmat.reshape(3, 3)[:, 2]
        np.testing.assert_allclose(np.abs(along), axis, atol=1e-12)


def test_sizes(model: mujoco.MjModel) -> None:
    for name, length in LENGTHS.items():
        assert model.geom(name).type[0] == mujoco.mjtGeom.mjGEOM_CAPSULE
        np.testing.assert_allclose(model.geom(name).size[:2], [RADIUS, length / 2], rtol=1e-12)
    for name in TIPS:
        assert model.geom(name).type[0] == mujoco.mjtGeom.mjGEOM_SPHERE
        assert model.geom(name).size[0] == TIP_RADIUS
    for name in BLOCKS:
        assert model.geom(name).type[0] == mujoco.mjtGeom.mjGEOM_BOX
        np.testing.assert_array_equal(model.geom(name).size, BLOCK)


def test_joints(model: mujoco.MjModel) -> None:
    slide, hinge = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
    assert model.jnt_type.tolist() == [slide, slide, hinge] + [slide] * 10
    x, y, z = np.eye(3)
    np.testing.assert_array_equal(model.jnt_axis, [x, y, z] + [x, y] * 5)
    np.testing.assert_array_equal(model.dof_damping, [0.5] * 3 + [1.5] * 10)
    np.testing.assert_array_equal(model.dof_armature, np.full(13, 0.04))
    np.testing.assert_array_equal(model.dof_frictionloss, np.zeros(13))
    np.testing.assert_array_equal(model.jnt_stiffness, np.zeros(13))
    assert model.jnt_limited.all()
    np.testing.assert_array_equal(model.jnt_range, [[-10.3213, 10.3]] * 13)


def test_contact_parameters(model: mujoco.MjModel) -> None:
    ones = np.ones((model.ngeom, 1))
    assert model.geom_condim.tolist() == [1] * model.ngeom
    np.testing.assert_array_equal(model.geom_margin, np.full(model.ngeom, 0.002))
    np.testing.assert_array_equal(model.geom_friction, ones * [0.8, 0.1, 0.1])
    # The engine's own.
    np.testing.assert_array_equal(model.geom_solref, ones * [0.02, 1])
    np.testing.assert_array_equal(model.geom_solimp, ones * [0.9, 0.95, 0.001, 0.5, 2])


def test_everything_but_the_table_can_be_touched(model: mujoco.MjModel) -> None:
    meets = (model.geom_contype[:, None] & model.geom_conaffinity[None]) != 0
    moving = np.array(["table", *moving_geoms()]) != "table"
    np.testing.assert_array_equal(meets, moving[:, None] & moving[None])


def test_actuators(model: mujoco.MjModel) -> None:
    assert model.actuator_trnid[:, 0].tolist() == [0, 1, 2]
    np.testing.assert_array_equal(model.actuator_gear, np.eye(6)[[0, 0, 0]])
    assert model.actuator_ctrllimited.all()
    np.testing.assert_array_equal(model.actuator_ctrlrange, [[-2, 2]] * 3)
    assert not model.actuator_forcelimited.any()


def test_blocks_have_colours_of_their_own(model: mujoco.MjModel) -> None:
    colours = [tuple(model.mat(block).rgba) for block in BLOCKS]
    others = [tuple(model.mat(name).rgba) for name in ("goal", "gripper", "table")]
    assert len({*colours, *others}) == 8
    assert model.site("goal_region").size[0] == 0.2
