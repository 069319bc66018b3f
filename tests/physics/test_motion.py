"""How the robots move, where a law of mechanics says how they must."""

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from physics.facts import BLOCK_MASS, GRIPPER_MASS, WHEEL_SPIN

from maesn.envs.ant import START, rotation_matrix
from maesn.physics import load_model

GRAVITY, TIME_STEP, FRICTION, ARMATURE = 9.81, 0.01, 0.4, 0.04
SHINS = [4, 7, 10, 13]
HOMES = 0.2 * np.arange(1, 6)


class Moving:
    """A model that is stepped."""

    def __init__(self, robot: str) -> None:
        self.model = load_model(robot)
        self.data = mujoco.MjData(self.model)

    def step(self, count: int = 1) -> set[tuple[str, ...]]:
        """Return the names of the geoms that touch on the way."""
        pairs = set()
        for _ in range(count):
            mujoco.mj_step(self.model, self.data)
            touching = self.data.contact.geom
            pairs |= {tuple(sorted(self.model.geom(i).name for i in pair)) for pair in touching}
        return pairs

    def forward(self) -> None:
        mujoco.mj_forward(self.model, self.data)


@pytest.fixture
def wheeled() -> Moving:
    return Moving("wheeled")


@pytest.fixture
def ant() -> Moving:
    ant = Moving("ant")
    mujoco.mj_resetDataKeyframe(ant.model, ant.data, 0)
    return ant


@pytest.fixture
def pushing() -> Moving:
    """The gripper at the origin, block 2 in its way at (0.3, 0), the others 5 m away."""
    pushing = Moving("blockpush")
    pushing.data.qpos[3::2] = 5.0
    pushing.data.qpos[4::2] = np.arange(5)
    pushing.data.qpos[7:9] = 0.3 - HOMES[2], 0.0
    return pushing


def test_in_the_air_the_wheeled_robot_feels_gravity_and_torque_alone(wheeled: Moving) -> None:
    wheeled.data.qpos[2] = 0.015  # wheels off the floor, and the upper stop not yet felt
    wheeled.data.ctrl[:] = [2.0, -0.5]
    wheeled.step()
    spin = TIME_STEP / WHEEL_SPIN
    expected = [0, 0, -GRAVITY * TIME_STEP, 0, 2.0 * spin, -0.5 * spin]
    np.testing.assert_allclose(wheeled.data.qvel, expected, rtol=1e-9, atol=1e-12)


def test_sliding_sideways_is_slowed_by_dry_friction(wheeled: Moving) -> None:
    wheeled.step(100)  # settle
    wheeled.data.qvel[1] = 2.0
    before = wheeled.data.qvel.copy()
    steps = 15  # two touches of the floor, both at sliding speed
    assert wheeled.step(steps) == {("floor", "left_wheel"), ("floor", "right_wheel")}
    sideways, upwards = (wheeled.data.qvel - before)[[1, 2]]
    # Coulomb's law over a time: m dv_y = -mu * (impulse of the floor) = -mu m (g t + dv_z).
    expected = -FRICTION * (GRAVITY * TIME_STEP * steps + upwards)
    assert sideways == pytest.approx(expected, rel=1e-9)


def test_both_wheels_drive_forwards(wheeled: Moving) -> None:
    wheeled.data.ctrl[:] = 1.0
    wheeled.step(100)
    assert wheeled.data.qpos[0] > 0.5
    np.testing.assert_allclose(wheeled.data.qpos[[1, 3]], 0, atol=1e-9)


def test_rotation_of_quaternions_of_any_length() -> None:
    for quaternion in np.random.default_rng(2).normal(size=(20, 4)):
        unit, axes = quaternion / np.linalg.norm(quaternion), np.empty(9)
        mujoco.mju_quat2Mat(axes, unit)
        got = rotation_matrix(jnp.asarray(quaternion, jnp.float32))
        np.testing.assert_allclose(got, axes.reshape(3, 3), atol=1e-6)


def test_in_the_air_the_ants_centre_of_mass_falls_freely(ant: Moving) -> None:
    np.testing.assert_array_equal(ant.model.key_qpos, [START])
    ant.data.qpos[2] = 5.0
    ant.data.ctrl[:] = np.linspace(-0.1, 0.1, 8)  # no joint gets to its limit
    ant.forward()
    before, steps = ant.data.subtree_com[1].copy(), 25
    assert not ant.step(steps)
    ant.forward()
    # What the joints do inside cannot move it; RK4 integrates a parabola without error.
    fall = [0, 0, -GRAVITY * (steps * TIME_STEP) ** 2 / 2]
    np.testing.assert_allclose(ant.data.subtree_com[1] - before, fall, atol=1e-9)


def test_standing_the_floor_carries_the_weight_of_the_ant(ant: Moving) -> None:
    ant.step(1000)
    ant.forward()
    weight = ant.model.body_subtreemass[0] * GRAVITY
    force = ant.data.cfrc_ext[SHINS, 3:].sum(axis=0)
    np.testing.assert_allclose(force, [0, 0, weight], atol=1e-2 * weight)


def test_each_motor_turns_its_own_joint_by_thirty_newton_metres(ant: Moving) -> None:
    for index in range(ant.model.nu):
        ant.data.ctrl[:] = 0.5 * np.eye(8)[index]
        ant.forward()
        torque = np.zeros(14)
        joint = ant.model.joint(ant.model.actuator(index).name)
        torque[joint.dofadr[0]] = 0.5 * 30
        np.testing.assert_array_equal(ant.data.qfrc_actuator, torque)


def test_the_way_of_the_gripper_without_contact(pushing: Moving) -> None:
    # Euler with implicit damping: (m + 0.04) (v' - v) / h = f - 0.5 v', and x' = x + h v'.
    inertia, speed, place = GRIPPER_MASS + ARMATURE, 0.0, 0.0
    data = pushing.data
    data.ctrl[0] = -1.5  # away from the block
    for _ in range(50):
        pushing.step()
        speed = (inertia * speed - TIME_STEP * 1.5) / (inertia + TIME_STEP * 0.5)
        place += TIME_STEP * speed
        np.testing.assert_allclose([data.qpos[0], data.qvel[0]], [place, speed], rtol=1e-6)
    assert data.qpos[0] < -1.0
    np.testing.assert_allclose(data.qpos[[1, 2]], 0, atol=1e-12)


def test_a_block_stops_within_a_hand(pushing: Moving) -> None:
    # Each step divides the speed by 1 + h 1.5 / 0.04 = 1.375: 1 m/s ends after h / 0.375 = 27 mm.
    pushing.data.qvel[7] = 1.0
    before = pushing.data.qpos[7]
    for step in range(1, 6):
        pushing.step()
        assert pushing.data.qvel[7] == pytest.approx(1.375**-step, rel=1e-5)
    pushing.step(60)
    assert pushing.data.qpos[7] - before == pytest.approx(TIME_STEP / 0.375, rel=1e-5)


def test_a_push_moves_its_block_and_nothing_else(pushing: Moving) -> None:
    # Contacts are internal forces, so of the two together: d(m1 v1 + m2 v2)/dt = f - d1 v1 - d2 v2.
    masses, data = (GRIPPER_MASS + ARMATURE, BLOCK_MASS + ARMATURE), pushing.data
    before, pairs = data.qpos.copy(), set()
    data.ctrl[0] = 1.0
    for _ in range(60):
        momentum = masses[0] * data.qvel[0] + masses[1] * data.qvel[7]
        pairs |= pushing.step()
        gained = masses[0] * data.qvel[0] + masses[1] * data.qvel[7] - momentum
        drag = 0.5 * data.qvel[0] + 1.5 * data.qvel[7]
        assert gained == pytest.approx(TIME_STEP * (1.0 - drag), rel=1e-5, abs=1e-9)
    moved = data.qpos - before
    assert pairs == {("block_2", "crossbar")}
    assert moved[7] > 0.1
    # Face against crossbar, 3 and 2 cm from their middles, up to a soft contact's few millimetres.
    assert data.qpos[7] + HOMES[2] - data.qpos[0] == pytest.approx(0.05, abs=5e-3)
    assert abs(moved[8]) < 1e-3  # the gripper is free to turn a little
    np.testing.assert_array_equal(np.delete(moved, [0, 1, 2, 7, 8]), 0)


def test_contacts_have_no_friction(pushing: Moving) -> None:
    # The crossbar is dragged along the face of the block: it pushes it away and never sideways.
    data = pushing.data
    data.qpos[0], data.qvel[0], data.qvel[1] = 0.2495, 0.5, 0.5
    assert pushing.step(10)
    assert data.qpos[7] + HOMES[2] > 0.301
    assert data.qpos[8] == pytest.approx(0.0, abs=1e-5)
