"""How the ant moves: where a law of mechanics says how it must."""

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from maesn.envs.ant import rotation_matrix

ROBOT = "ant"
SHINS = [4, 7, 10, 13]
GRAVITY, TIME_STEP = 9.81, 0.01


@pytest.fixture
def data(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    return data


def test_rotation_of_quaternions_of_any_length() -> None:
    generator = np.random.default_rng(2)
    for quaternion in generator.normal(size=(20, 4)):
        unit, axes = quaternion / np.linalg.norm(quaternion), np.empty(9)
        mujoco.mju_quat2Mat(axes, unit)
        got = rotation_matrix(jnp.asarray(quaternion, jnp.float32))
        np.testing.assert_allclose(got, axes.reshape(3, 3), atol=1e-6)


def test_the_keyframe_is_where_episodes_start(model: mujoco.MjModel) -> None:
    noiseless = np.asarray([0, 0, 0.55, 1, 0, 0, 0, 0, 1, 0, -1, 0, -1, 0, 1])
    np.testing.assert_array_equal(model.key_qpos, noiseless[None])


def test_in_the_air_the_centre_of_mass_falls_freely(
    model: mujoco.MjModel, data: mujoco.MjData
) -> None:
    data.qpos[2] = 5.0
    data.ctrl[:] = np.linspace(-0.1, 0.1, 8)  # no joint gets to its limit
    mujoco.mj_forward(model, data)
    before = data.subtree_com[1].copy()
    steps = 25
    for _ in range(steps):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    time = steps * TIME_STEP
    # What the joints do inside cannot move it; RK4 integrates a parabola without error.
    fall = [0, 0, -GRAVITY * time**2 / 2]
    np.testing.assert_allclose(data.subtree_com[1] - before, fall, atol=1e-9)
    assert not data.ncon


def test_standing_the_floor_carries_the_weight(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    for _ in range(1000):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    weight = model.body_subtreemass[0] * GRAVITY
    force = data.cfrc_ext[SHINS, 3:].sum(axis=0)
    np.testing.assert_allclose(force, [0, 0, weight], atol=1e-2 * weight)


def test_each_motor_turns_its_own_joint_by_thirty_newton_metres(model: mujoco.MjModel) -> None:
    for index in range(model.nu):
        data = mujoco.MjData(model)
        data.ctrl[index] = 0.5
        mujoco.mj_forward(model, data)
        torque = np.zeros(14)
        torque[model.joint(model.actuator(index).name).dofadr[0]] = 0.5 * 30
        np.testing.assert_array_equal(data.qfrc_actuator, torque)
