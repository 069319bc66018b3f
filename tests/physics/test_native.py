"""`NativeSimulator` against loops of plain `mujoco.mj_step`, one simulation at a time."""

import copy

import mujoco
import numpy as np
import pytest
from physics.plain import (
    NUM_SIMULATIONS,
    STATE,
    assert_equal,
    controls,
    plain,
    plain_episodes,
    play,
    start,
)

from maesn.physics import NativeSimulator, PhysicsError, load_model

TOUCHED = {
    "ant": (*STATE, "cfrc_ext", "subtree_com", "xmat", "qfrc_constraint"),
    "blockpush": (*STATE, "geom_xpos", "qfrc_constraint"),
}
DERIVED = (*STATE, "geom_xpos", "subtree_com", "cvel", "qacc", "qfrc_constraint")


@pytest.mark.parametrize("num_threads", [1, 2, 5])
def test_equals_plain_mujoco_bit_for_bit(num_threads: int) -> None:
    simulator = NativeSimulator("wheeled", NUM_SIMULATIONS, num_threads=num_threads)
    assert_equal(play(simulator), plain([load_model("wheeled")] * NUM_SIMULATIONS, STATE))


@pytest.mark.parametrize("num_threads", [1, 2])
@pytest.mark.parametrize("robot", ["ant", "blockpush"])
def test_episodes_with_contacts_equal_plain_mujoco(robot: str, num_threads: int) -> None:
    model, stream = load_model(robot), np.random.default_rng(1)
    qpos = np.tile(model.key_qpos[0] if model.nkey else model.qpos0, (6, 1))
    qvel = 0.1 * stream.normal(size=(6, model.nv))
    # Forwards on the whole, where blocks are.
    control = model.actuator_ctrlrange[0, 1] * stream.uniform(-0.5, 1, size=(200, 6, model.nu))
    simulator = NativeSimulator(robot, 6, TOUCHED[robot], num_threads=num_threads)
    got = [simulator.reset(qpos, qvel), *(simulator.step(row) for row in control)]
    assert_equal(got, plain_episodes([model] * 6, qpos, qvel, control, TOUCHED[robot]))
    assert np.any([reading["qfrc_constraint"] for reading in got], axis=(0, 2)).all()


@pytest.mark.parametrize("num_threads", [1, 2])
@pytest.mark.parametrize("frame_skip", [1, 3])
def test_derived_readings_belong_to_the_returned_state(num_threads: int, frame_skip: int) -> None:
    simulator = NativeSimulator("wheeled", NUM_SIMULATIONS, DERIVED, frame_skip, num_threads)
    models = [load_model("wheeled")] * NUM_SIMULATIONS
    assert_equal(play(simulator), plain(models, DERIVED, frame_skip))


def test_single_precision_is_accepted_and_widened() -> None:
    simulator = NativeSimulator("wheeled.xml", NUM_SIMULATIONS)
    single = [values.astype(np.float32) for values in (*start(), controls()[0])]
    double = [values.astype(np.float64) for values in single]
    narrow = [simulator.reset(*single[:2]), simulator.step(single[2])]
    wide = [simulator.reset(*double[:2]), simulator.step(double[2])]
    assert_equal(narrow, wide)
    assert {value.dtype for value in narrow[1].values()} == {np.dtype(np.float64)}


def test_readings_are_copies() -> None:
    simulator = NativeSimulator("wheeled", NUM_SIMULATIONS, DERIVED)
    undisturbed = play(simulator)
    readings = simulator.reset(*start())
    kept = copy.deepcopy(readings)
    control = controls()[0]
    stepped = simulator.step(control)
    assert_equal([readings], [kept])
    for value in stepped.values():
        value[...] = np.nan
    control[...] = np.nan
    assert_equal([simulator.step(controls()[1])], [undisturbed[2]])


def masses(model: mujoco.MjModel) -> tuple[dict[str, np.ndarray], list[mujoco.MjModel]]:
    """Robots of growing mass, as fields of a batch and as models of their own."""
    factors = np.linspace(0.5, 2.0, NUM_SIMULATIONS)
    fields = {
        "body_mass": factors[:, None] * model.body_mass,
        "body_inertia": factors[:, None, None] * model.body_inertia,
        "opt.gravity": factors[:, None] * model.opt.gravity,
    }
    models = []
    for index in range(NUM_SIMULATIONS):
        own = copy.copy(model)
        own.body_mass[:] = fields["body_mass"][index]
        own.body_inertia[:] = fields["body_inertia"][index]
        own.opt.gravity[:] = fields["opt.gravity"][index]
        models.append(own)
    return fields, models


def test_model_fields_change_the_dynamics_and_what_follows_from_them() -> None:
    fields, models = masses(load_model("wheeled"))
    simulator = NativeSimulator("wheeled", NUM_SIMULATIONS)
    got = play(simulator, model_fields=fields)
    inconsistent = plain(models, STATE)
    for model in models:
        mujoco.mj_setConst(model, mujoco.MjData(model))
    assert_equal(got, plain(models, STATE))
    # So that the comparison means something: mj_setConst matters here, and so do the fields.
    assert (got[-1]["qpos"] != inconsistent[-1]["qpos"]).any()
    assert np.abs(got[-1]["qpos"] - play(simulator)[-1]["qpos"]).max() > 0.01


def test_fields_that_are_not_given_again_return_to_the_models() -> None:
    simulator = NativeSimulator("wheeled", NUM_SIMULATIONS)
    own = play(simulator)
    fields, _ = masses(load_model("wheeled"))
    changed = play(simulator, model_fields=fields)
    assert_equal(play(simulator, model_fields={}), own)
    only = {"geom_friction": np.tile(load_model("wheeled").geom_friction, (12, 1, 1)) / 2}
    slippery = play(NativeSimulator("wheeled", NUM_SIMULATIONS), model_fields=only)
    assert_equal(play(simulator, model_fields=only), slippery)
    assert_equal(play(simulator, model_fields=fields), changed)


def test_fields_of_a_wrong_shape_or_value_are_refused() -> None:
    simulator = NativeSimulator("wheeled", NUM_SIMULATIONS)
    with pytest.raises(ValueError, match=r"`body_mass` must have the shape \(12, 5\)"):
        simulator.reset(*start(), {"body_mass": np.ones((NUM_SIMULATIONS, 4))})
    mass = np.ones((NUM_SIMULATIONS, 5))
    mass[3, 2] = np.nan
    with pytest.raises(PhysicsError, match="simulation 3: `body_mass` must be finite"):
        simulator.reset(*start(), {"body_mass": mass})
    with pytest.raises(ValueError, match="body_mass"):
        simulator.reset(*start(), {"body_mas": mass})
