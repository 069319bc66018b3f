"""How the ant moves: against plain MuJoCo, and where a law of mechanics says how it must."""

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from physics.plain import assert_equal, plain_episodes

from maesn.envs import Ant
from maesn.envs.ant import rotation_matrix
from maesn.physics import NativeSimulator, Readings

ROBOT = "ant"
SIMULATIONS, STEPS = 6, 200  # whole episodes
READ = (*Ant.readings, "xmat")
SHINS = [4, 7, 10, 13]
GRAVITY, TIME_STEP = 9.81, 0.01


@pytest.fixture
def data(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    return data


def begin(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(0)
    qpos = model.key_qpos[0] + 0.01 * generator.normal(size=(SIMULATIONS, 15))
    return qpos, 0.1 * generator.normal(size=(SIMULATIONS, 14))


def controls() -> np.ndarray:
    return np.random.default_rng(1).uniform(-1, 1, size=(STEPS, SIMULATIONS, 8))


@pytest.fixture(scope="module")
def expected(model: mujoco.MjModel) -> list[Readings]:
    return plain_episodes([model] * SIMULATIONS, *begin(model), controls(), READ)


@pytest.mark.parametrize("num_threads", [1, 2])
def test_equals_plain_mujoco_bit_for_bit(
    model: mujoco.MjModel, expected: list[Readings], num_threads: int
) -> None:
    simulator = NativeSimulator("ant", SIMULATIONS, READ, num_threads=num_threads)
    got = [simulator.reset(*begin(model))]
    assert_equal(got + [simulator.step(control) for control in controls()], expected)


def test_readings_the_environment_asks_for_do_not_change_the_motion(
    model: mujoco.MjModel, expected: list[Readings]
) -> None:
    simulator = NativeSimulator("ant", SIMULATIONS, Ant.readings)
    simulator.reset(*begin(model))
    last = [simulator.step(control) for control in controls()][-1]
    for name in Ant.readings:
        np.testing.assert_array_equal(last[name], expected[-1][name], name)


def test_the_ant_walks_on_its_four_shins(expected: list[Readings]) -> None:
    forces = np.stack([moment["cfrc_ext"] for moment in expected])
    touched = (forces != 0).any(axis=(0, 1, 3))
    assert np.flatnonzero(touched).tolist() == SHINS
    # Guards the comparisons above: ants at rest would agree as well.
    assert np.ptp([moment["subtree_com"][:, 1] for moment in expected], axis=0).max() > 0.05


def test_observations_are_the_engines_own_quantities(expected: list[Readings]) -> None:
    for moment in expected[:: STEPS // 4]:
        for index in range(SIMULATIONS):
            one = {name: np.float32(value[index]) for name, value in moment.items()}
            seen = Ant().observe({name: jnp.asarray(one[name]) for name in Ant.readings})
            assert seen.shape == (125,)
            parts = np.split(np.asarray(seen), [15, 29, 113, 122])
            np.testing.assert_array_equal(parts[0], one["qpos"])
            np.testing.assert_array_equal(parts[1], one["qvel"])
            clipped = np.clip(one["cfrc_ext"][:14], -1, 1)
            np.testing.assert_array_equal(parts[2], clipped.ravel())
            np.testing.assert_allclose(parts[3], one["xmat"][1], atol=3e-7)
            np.testing.assert_array_equal(parts[4], one["subtree_com"][1])


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
