"""The compiled ant against the numbers of the experiment's description."""

import math

import mujoco
import numpy as np
import pytest
from physics.robots import inertia_tensor, names

ROBOT = "ant"
DENSITY = 5.0
BALL, TUBE = 0.25, 0.08  # radii
UPPER, SHIN = 0.2 * math.sqrt(2), 0.4 * math.sqrt(2)  # lengths between the centres of the caps
LEGS = (1, 2, 3, 4)
DIRECTIONS = {1: (1, 1, 0), 2: (-1, 1, 0), 3: (-1, -1, 0), 4: (1, -1, 0)}
JOINTS = ["root", *(f"{joint}_{leg}" for leg in LEGS for joint in ("hip", "ankle"))]
MOTORS = [f"{joint}_{leg}" for leg in (4, 1, 2, 3) for joint in ("hip", "ankle")]
PARTS = [f"{part}_{leg}" for leg in LEGS for part in ("leg", "thigh", "shin")]
BODIES = ["world", "torso", *PARTS, "goal"]


def volume(length: float) -> float:
    return math.pi * TUBE**2 * length + 4 / 3 * math.pi * TUBE**3


TORSO_MASS = DENSITY * 4 / 3 * math.pi * BALL**3
UPPER_MASS, SHIN_MASS = DENSITY * volume(UPPER), DENSITY * volume(SHIN)
MASSES = {"world": 0.0, "torso": TORSO_MASS, "goal": 0.0} | {
    part: SHIN_MASS if part.startswith("shin") else UPPER_MASS for part in PARTS
}


def test_simulation_options(model: mujoco.MjModel) -> None:
    assert model.opt.timestep == 0.01
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    np.testing.assert_array_equal(model.opt.gravity, [0, 0, -9.81])
    assert model.opt.disableflags == mujoco.mjtDisableBit.mjDSBL_AUTORESET
    assert model.opt.enableflags == 0


def test_order_of_coordinates_and_parts(model: mujoco.MjModel) -> None:
    kinds = mujoco.mjtObj
    assert (model.nq, model.nv, model.nu, model.na) == (15, 14, 8, 0)
    assert names(model, kinds.mjOBJ_JOINT, model.njnt) == JOINTS
    assert names(model, kinds.mjOBJ_BODY, model.nbody) == BODIES
    assert names(model, kinds.mjOBJ_GEOM, model.ngeom) == ["floor", "torso", *PARTS]


def test_masses(model: mujoco.MjModel) -> None:
    for body, mass in MASSES.items():
        assert model.body(body).mass[0] == pytest.approx(mass, rel=1e-12)
    assert model.body_subtreemass[0] == pytest.approx(sum(MASSES.values()), rel=1e-12)
    assert sum(MASSES.values()) == pytest.approx(0.911, abs=5e-4)


def test_inertia_of_the_torso_is_that_of_a_uniform_ball(model: mujoco.MjModel) -> None:
    expected = 2 / 5 * TORSO_MASS * BALL**2 * np.eye(3)
    np.testing.assert_allclose(inertia_tensor(model, "torso"), expected, rtol=1e-12, atol=1e-18)


def capsule_inertia(length: float, direction: np.ndarray) -> np.ndarray:
    """A cylinder and two half balls, whose centres of mass are 3/8 r beyond their flat sides."""
    cylinder = DENSITY * math.pi * TUBE**2 * length
    ball = DENSITY * 4 / 3 * math.pi * TUBE**3
    along = cylinder * TUBE**2 / 2 + ball * 2 / 5 * TUBE**2
    offset = length / 2 + 3 / 8 * TUBE
    # A half ball about its own centre of mass: 83/320 m r^2 across.
    across = cylinder * (TUBE**2 / 4 + length**2 / 12)
    across += ball * (83 / 320 * TUBE**2 + offset**2)
    unit = direction / np.linalg.norm(direction)
    return across * np.eye(3) + (along - across) * np.outer(unit, unit)


@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize(("part", "length"), [("leg", UPPER), ("thigh", UPPER), ("shin", SHIN)])
def test_parts_of_a_leg_are_uniform_capsules(
    model: mujoco.MjModel, part: str, length: float, leg: int
) -> None:
    name, direction = f"{part}_{leg}", np.asarray(DIRECTIONS[leg], float)
    expected = capsule_inertia(length, direction)
    np.testing.assert_allclose(inertia_tensor(model, name), expected, rtol=1e-11, atol=1e-16)
    middle = length / 2 * direction / math.sqrt(2)
    np.testing.assert_allclose(model.body(name).ipos, middle, atol=1e-15)
    assert model.geom(name).type[0] == mujoco.mjtGeom.mjGEOM_CAPSULE
    np.testing.assert_allclose(model.geom(name).size[:2], [TUBE, length / 2], rtol=1e-12)


def test_places_in_the_world(data: mujoco.MjData) -> None:
    np.testing.assert_array_equal(data.body("torso").xpos, [0, 0, 0.55])
    for leg, direction in DIRECTIONS.items():
        for distance, part in enumerate(("leg", "thigh", "shin")):
            place = 0.2 * distance * np.asarray(direction) + [0, 0, 0.55]
            np.testing.assert_allclose(data.body(f"{part}_{leg}").xpos, place, atol=1e-15)


def test_joints(model: mujoco.MjModel) -> None:
    free, hinge = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_HINGE)
    assert model.jnt_type.tolist() == [free] + 8 * [hinge]
    assert model.jnt_limited.tolist() == [False] + 8 * [True]
    side = math.sqrt(0.5)
    axes = {1: (-side, side, 0), 2: (side, side, 0), 3: (-side, side, 0), 4: (side, side, 0)}
    degrees = {1: (30, 70), 2: (-70, -30), 3: (-70, -30), 4: (30, 70)}
    for leg in LEGS:
        hip, ankle = model.joint(f"hip_{leg}"), model.joint(f"ankle_{leg}")
        np.testing.assert_array_equal(hip.axis, [0, 0, 1])
        np.testing.assert_allclose(hip.range, np.deg2rad([-30, 30]), rtol=1e-15)
        np.testing.assert_allclose(ankle.axis, axes[leg], rtol=1e-15)
        np.testing.assert_allclose(ankle.range, np.deg2rad(degrees[leg]), rtol=1e-15)
        np.testing.assert_array_equal([hip.pos, ankle.pos], np.zeros((2, 3)))


def test_only_the_joints_of_the_legs_resist(model: mujoco.MjModel) -> None:
    legs = [0.0] * 6 + [1.0] * 8
    np.testing.assert_array_equal(model.dof_damping, legs)
    np.testing.assert_array_equal(model.dof_armature, legs)
    for name in ("dof_frictionloss", "jnt_stiffness", "jnt_margin"):
        assert not getattr(model, name).any()


def test_contact_parameters(model: mujoco.MjModel) -> None:
    ones = np.ones((model.ngeom, 1))
    np.testing.assert_array_equal(model.geom_friction, ones * [1, 0.5, 0.5])
    np.testing.assert_array_equal(model.geom_solref, ones * [0.02, 1])  # the engine's own
    np.testing.assert_array_equal(model.geom_solimp, ones * [0.9, 0.95, 0.001, 0.5, 2])
    np.testing.assert_array_equal(model.geom_margin[1:], np.full(13, 0.01))
    assert model.geom_condim.tolist() == [3] * model.ngeom


def test_the_margin_of_a_contact_is_the_experiments(
    model: mujoco.MjModel, data: mujoco.MjData
) -> None:
    """Whether the engine adds up the margins of what touches or takes the larger one."""
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[2] = 0.2
    mujoco.mj_forward(model, data)
    assert data.ncon == 5
    np.testing.assert_array_equal(data.contact.includemargin, np.full(5, 0.01))
    # The larger friction of the two: sliding in both directions, spinning, rolling.
    np.testing.assert_array_equal(data.contact.friction, np.tile([1, 1, 0.5, 0.5, 0.5], (5, 1)))


def test_actuators(model: mujoco.MjModel) -> None:
    assert names(model, mujoco.mjtObj.mjOBJ_ACTUATOR, model.nu) == MOTORS
    joints = [model.joint(name).id for name in MOTORS]
    assert model.actuator_trnid[:, 0].tolist() == joints
    np.testing.assert_array_equal(model.actuator_gear, np.eye(6)[[0] * 8] * 30)
    np.testing.assert_array_equal(model.actuator_gainprm[:, 0], np.ones(8))
    assert model.actuator_ctrllimited.all()
    np.testing.assert_array_equal(model.actuator_ctrlrange, [[-1, 1]] * 8)
    assert not model.actuator_forcelimited.any()


def test_only_the_floor_can_be_touched(model: mujoco.MjModel) -> None:
    meets = (model.geom_contype[:, None] & model.geom_conaffinity[None]) != 0
    floor = np.arange(model.ngeom) == 0
    np.testing.assert_array_equal((meets | meets.T)[np.ix_(~floor, ~floor)], False)
    np.testing.assert_array_equal((meets | meets.T)[np.ix_(~floor, floor)], True)
