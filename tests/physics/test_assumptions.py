"""What `maesn.physics` takes for granted about MuJoCo, and would silently go wrong without."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch

from maesn.physics import load_model

NUM_SIMULATIONS = 8
NONE, ACC = int(mujoco.mjtStage.mjSTAGE_NONE), int(mujoco.mjtStage.mjSTAGE_ACC)
BAD_VELOCITY = int(mujoco.mjtWarning.mjWARN_BADQVEL)
BAD_CONTROL = int(mujoco.mjtWarning.mjWARN_BADCTRL)


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def model() -> mujoco.MjModel:
    return load_model("wheeled")


@pytest.fixture
def batch(model: mujoco.MjModel) -> Batch:
    batch = Batch(model, NUM_SIMULATIONS, 2)
    disturb(batch)
    return batch


def disturb(batch: Batch) -> None:
    generator = np.random.default_rng(0)
    batch.reset(stage=NONE)
    batch.bind("qpos")[:] = 0.01 * generator.normal(size=(NUM_SIMULATIONS, 6))
    batch.bind("qvel")[:] = 0.1 * generator.normal(size=(NUM_SIMULATIONS, 6))


def controls(steps: int) -> np.ndarray:
    return np.random.default_rng(1).uniform(-2, 2, size=(steps, NUM_SIMULATIONS, 2))


def test_bound_arrays_are_live(batch: Batch) -> None:
    position, place = batch.bind("qpos"), batch.bind("geom_xpos")
    before = position.copy(), place.copy()
    batch.step()
    assert batch.bind("qpos").base is position.base
    assert (position != before[0]).any()
    assert (place != before[1]).any()


def test_a_blow_up_is_reset_without_a_word_by_default(model: mujoco.MjModel) -> None:
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    batch = Batch(model, NUM_SIMULATIONS, 2)
    disturb(batch)
    batch.bind("qvel")[3] = np.nan
    batch.step()
    np.testing.assert_allclose(batch.bind("qpos")[3], 0, atol=1e-3)
    assert not batch.status.any()


def test_without_automatic_reset_a_blow_up_stays(batch: Batch) -> None:
    batch.bind("qvel")[3] = np.nan
    batch.step()
    assert np.isnan(batch.bind("qpos")[3]).all()
    assert not batch.status.any()
    np.testing.assert_array_equal(np.isfinite(batch.bind("qpos")).all(axis=1), np.arange(8) != 3)


def test_warning_counters_add_up_until_a_reset(batch: Batch) -> None:
    batch.bind("qvel")[3] = np.nan
    counts = []
    for _ in range(3):
        batch.step()
        counts.append(batch.warning[:, BAD_VELOCITY, 1].copy())
    np.testing.assert_array_equal(counts, np.outer([1, 2, 3], np.arange(8) == 3))
    batch.reset(stage=NONE)
    assert not batch.warning.any()


def test_a_control_that_is_not_a_number_becomes_zero(batch: Batch) -> None:
    batch.bind("ctrl")[3] = [np.nan, 2.0]
    batch.step()
    got = batch.bind("qvel").copy()
    disturb(batch)
    batch.step()
    np.testing.assert_array_equal(got, batch.bind("qvel"))
    batch.bind("ctrl")[3] = [np.nan, 2.0]
    batch.step()
    assert batch.warning[3, BAD_CONTROL, 1] == 1


def test_a_reset_leaves_nothing_behind(batch: Batch, model: mujoco.MjModel) -> None:
    for control in controls(20):
        batch.bind("ctrl")[:] = control
        batch.step(stage=ACC)
    assert batch.bind("qacc_warmstart").any()
    batch.reset(stage=NONE)
    np.testing.assert_array_equal(batch.state, Batch(model, NUM_SIMULATIONS, 1).state)


def test_step_with_stage_is_step_then_forward(batch: Batch, model: mujoco.MjModel) -> None:
    other = Batch(model, NUM_SIMULATIONS, 1)
    disturb(other)
    fields = ("qpos", "qvel", "geom_xpos", "subtree_com", "cvel", "qacc", "qfrc_constraint")
    for batch_ in (batch, other):
        for name in fields:
            batch_.bind(name)
    for control in controls(50):
        batch.bind("ctrl")[:] = control
        other.bind("ctrl")[:] = control
        batch.step(stage=ACC)
        other.step()
        other.forward()
        for name in fields:
            np.testing.assert_array_equal(batch.bind(name), other.bind(name), name)


def test_plain_step_leaves_derived_fields_behind_but_the_path_alone(
    batch: Batch, model: mujoco.MjModel
) -> None:
    other = Batch(model, NUM_SIMULATIONS, 2)
    disturb(other)
    behind, current = batch.bind("geom_xpos"), other.bind("geom_xpos")
    for control in controls(50):
        earlier = current.copy()
        batch.bind("ctrl")[:] = control
        other.bind("ctrl")[:] = control
        batch.step()
        other.step(stage=ACC)
        np.testing.assert_array_equal(batch.bind("qpos"), other.bind("qpos"))
        assert (behind != current).any()
        if earlier.any():
            np.testing.assert_array_equal(behind, earlier)


def test_set_const_of_the_models_own_values_changes_nothing(
    batch: Batch, model: mujoco.MjModel
) -> None:
    other = Batch(model, NUM_SIMULATIONS, 2)
    other.expand("body_mass")[:] = model.body_mass
    other.set_const()
    disturb(other)
    for control in controls(50):
        for batch_ in (batch, other):
            batch_.bind("ctrl")[:] = control
            batch_.step()
    np.testing.assert_array_equal(batch.state, other.state)


def test_a_handler_hears_the_warnings_of_all_threads_in_place_of_a_file(batch: Batch) -> None:
    previous = mujoco.get_mju_user_warning()
    heard: list[str] = []
    mujoco.set_mju_user_warning(heard.append)
    try:
        batch.bind("qvel")[:] = np.nan
        batch.step()
    finally:
        mujoco.set_mju_user_warning(previous)
    assert sum("QVEL" in message for message in heard) == NUM_SIMULATIONS
    assert not list(Path().iterdir())
