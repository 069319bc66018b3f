"""How gripper and blocks move: laws of mechanics."""

import mujoco
import numpy as np
import pytest

ROBOT = "blockpush"
TIME_STEP, ARMATURE = 0.01, 0.04
GRIPPER_MASS, BLOCK_MASS = 0.00611563, 1.8e-7  # kg; see `test_models.py`
HOMES = 0.2 * np.arange(1, 6)
AWAY = 5.0  # metres; as far as no other block is


@pytest.fixture
def data(model: mujoco.MjModel) -> mujoco.MjData:
    """The gripper at the origin, block 2 in its way at (0.3, 0), the others far off."""
    data = mujoco.MjData(model)
    data.qpos[3::2] = AWAY
    data.qpos[4::2] = np.arange(5)
    data.qpos[7:9] = 0.3 - HOMES[2], 0.0
    return data


def coordinates_of(block: int) -> list[int]:
    return [3 + 2 * block, 4 + 2 * block]


def test_the_way_of_the_gripper_without_contact(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    # Euler with implicit damping: (m + 0.04) (v' - v) / h = f - 0.5 v', and x' = x + h v'.
    inertia, speed, place = GRIPPER_MASS + ARMATURE, 0.0, 0.0
    data.ctrl[0] = -1.5  # away from the block
    for _ in range(50):
        mujoco.mj_step(model, data)
        speed = (inertia * speed - TIME_STEP * 1.5) / (inertia + TIME_STEP * 0.5)
        place += TIME_STEP * speed
        np.testing.assert_allclose([data.qpos[0], data.qvel[0]], [place, speed], rtol=1e-6)
    assert data.qpos[0] < -1.0
    np.testing.assert_allclose(data.qpos[[1, 2]], 0, atol=1e-12)


def test_a_block_stops_within_a_hand(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    # Each step divides the speed by 1 + h 1.5 / 0.04 = 1.375: 1 m/s ends after h / 0.375 = 27 mm.
    data.qvel[7] = 1.0
    before = data.qpos[7]
    for step in range(1, 6):
        mujoco.mj_step(model, data)
        assert data.qvel[7] == pytest.approx(1.375**-step, rel=1e-5)
    for _ in range(60):
        mujoco.mj_step(model, data)
    assert data.qpos[7] - before == pytest.approx(TIME_STEP / 0.375, rel=1e-5)


def test_a_push_moves_its_block_and_nothing_else(
    model: mujoco.MjModel, data: mujoco.MjData
) -> None:
    before, pairs = data.qpos.copy(), set()
    data.ctrl[0] = 1.0
    for _ in range(60):
        mujoco.mj_step(model, data)
        pairs |= {tuple(sorted(model.geom(i).name for i in pair)) for pair in data.contact.geom}
    moved = data.qpos - before
    assert pairs == {("block_2", "crossbar")}
    assert moved[7] > 0.1
    # Face against crossbar, 3 and 2 cm from their middles, up to a soft contact's few millimetres.
    assert data.qpos[7] + HOMES[2] - data.qpos[0] == pytest.approx(0.05, abs=5e-3)
    assert abs(moved[8]) < 1e-3  # the gripper is free to turn a little
    others = [i for i in range(3, 13) if i not in coordinates_of(2)]
    np.testing.assert_array_equal(moved[others], 0)


def test_a_push_obeys_the_balance_of_momentum(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    # Contacts are internal forces, so of the two together: d(m1 v1 + m2 v2)/dt = f - d1 v1 - d2 v2.
    masses = GRIPPER_MASS + ARMATURE, BLOCK_MASS + ARMATURE
    data.ctrl[0] = 1.0
    for _ in range(60):
        momentum = masses[0] * data.qvel[0] + masses[1] * data.qvel[7]
        mujoco.mj_step(model, data)
        gained = masses[0] * data.qvel[0] + masses[1] * data.qvel[7] - momentum
        drag = 0.5 * data.qvel[0] + 1.5 * data.qvel[7]
        assert gained == pytest.approx(TIME_STEP * (1.0 - drag), rel=1e-5, abs=1e-9)
    assert data.ncon > 0


def test_contacts_have_no_friction(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    # The crossbar is dragged along the face of the block: it pushes it away and never sideways.
    data.qpos[0], data.qvel[0], data.qvel[1] = 0.2495, 0.5, 0.5
    touched = 0
    for _ in range(10):
        mujoco.mj_step(model, data)
        touched += data.ncon
    assert touched > 0
    assert data.qpos[7] + HOMES[2] > 0.301
    assert data.qpos[8] == pytest.approx(0.0, abs=1e-5)
