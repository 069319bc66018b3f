"""How the wheeled robot moves, where a law of mechanics says how it must."""

import mujoco
import numpy as np
import pytest

ROBOT = "wheeled"
GRAVITY, TIME_STEP, FRICTION = 9.81, 0.01, 0.4
WHEEL_SPIN = 2.612362039296805 * 0.1**2 / 2  # kg m^2: a uniform cylinder about its axis


@pytest.fixture
def data(model: mujoco.MjModel) -> mujoco.MjData:
    return mujoco.MjData(model)


def test_forces_in_the_air_are_gravity_and_torque_alone(
    model: mujoco.MjModel, data: mujoco.MjData
) -> None:
    data.qpos[2] = 0.015  # wheels off the floor, and the upper stop not yet felt
    data.ctrl[:] = [2.0, -0.5]
    mujoco.mj_step(model, data)
    spin = TIME_STEP / WHEEL_SPIN
    expected = [0, 0, -GRAVITY * TIME_STEP, 0, 2.0 * spin, -0.5 * spin]
    np.testing.assert_allclose(data.qvel, expected, rtol=1e-9, atol=1e-12)


def test_sliding_sideways_is_slowed_by_dry_friction(
    model: mujoco.MjModel, data: mujoco.MjData
) -> None:
    for _ in range(100):  # settle
        mujoco.mj_step(model, data)
    data.qvel[1] = 2.0
    before = data.qvel.copy()
    steps = 15  # two touches of the floor, both at sliding speed
    for _ in range(steps):
        mujoco.mj_step(model, data)
    sideways, upwards = (data.qvel - before)[[1, 2]]
    # Coulomb's law over a time: m dv_y = -mu * (impulse of the floor) = -mu m (g t + dv_z).
    expected = -FRICTION * (GRAVITY * TIME_STEP * steps + upwards)
    assert sideways == pytest.approx(expected, rel=1e-9)


def test_both_wheels_drive_forwards(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    for _ in range(100):
        data.ctrl[:] = 1.0
        mujoco.mj_step(model, data)
    assert data.qpos[0] > 0.5
    np.testing.assert_allclose(data.qpos[[1, 3]], 0, atol=1e-9)
