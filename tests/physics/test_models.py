"""The compiled robots against the numbers of the experiments' descriptions."""

from operator import attrgetter
from typing import Any

import mujoco
import numpy as np
import pytest
from physics.facts import (
    ANT,
    BLOCK_MASS,
    BLOCKPUSH,
    CAPSULES,
    CAR_MASS,
    DOWN,
    FACTS,
    FREE,
    GRIPPER_MASS,
    HINGE,
    HIP,
    KINDS,
    LEFT,
    RIGHT,
    SLIDE,
    UP,
    WHEEL_MASS,
    WHEELS,
    Facts,
    X,
    Y,
    Z,
)
from physics.robots import inertia_tensor, names, text_of, without_looks

from maesn.physics import load_model

LEGS, GRAVITY, GRIPPER = [0] * 6 + [1] * 8, -9.81 * Z, [SLIDE, SLIDE, HINGE]
EULER, RK4 = mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_RK4
WHEELED_RANGES = np.outer(np.arange(6) == 2, [-1, 0.03])
ANT_RANGES = [[0, 0], HIP, UP, HIP, DOWN, HIP, DOWN, HIP, UP]
ANT_MOTORS = [[joint, -1] for joint in (7, 8, 1, 2, 3, 4, 5, 6)]
USUAL_IMPEDANCE = [0.9, 0.95, 0.001, 0.5, 2]  # the engine's own
# By the names of `mujoco.MjModel`, broadcast to their shapes: of all, or wheeled, ant, blockpush.
NUMBERS: dict[str, Any] = {
    "opt.timestep": 0.01,
    "opt.disableflags": mujoco.mjtDisableBit.mjDSBL_AUTORESET,
    "opt.enableflags": 0,
    "opt.integrator": (EULER, RK4, EULER),
    "opt.gravity": (GRAVITY, GRAVITY, 0),
    "nq": (6, 15, 13),
    "nv": (6, 14, 13),
    "nu": (2, 8, 3),
    "na": 0,
    "jnt_type": ([SLIDE] * 3 + [HINGE] * 3, [FREE] + 8 * [HINGE], GRIPPER + [SLIDE] * 10),
    "jnt_axis": ([X, Y, Z, Z, Y, Y], [Z, *[Z, RIGHT, Z, LEFT] * 2], [X, Y, Z] + [X, Y] * 5),
    "jnt_limited": ([0, 0, 1, 0, 0, 0], [0] + 8 * [1], 1),
    "jnt_range": (WHEELED_RANGES, ANT_RANGES, [-10.3213, 10.3]),
    "jnt_margin": ([0.01] * 4 + [0] * 2, 0, 0),
    "jnt_stiffness": 0,
    "dof_damping": (0, LEGS, [0.5] * 3 + [1.5] * 10),
    "dof_armature": (0, LEGS, 0.04),
    "dof_frictionloss": 0,
    "geom_friction": (0.4, [1, 0.5, 0.5], [0.8, 0.1, 0.1]),
    "geom_margin": (0, [0] + [0.01] * 13, 0.002),
    "geom_condim": (3, 3, 1),
    "geom_solref": [0.02, 1],  # the engine's own
    # The last two of the wheeled robot are the engine's: MuJoCo 1.31 knew three numbers.
    "geom_solimp": ([0, 0.8, 0.01, 0.5, 2], USUAL_IMPEDANCE, USUAL_IMPEDANCE),
    "actuator_trnid": ([[4, -1], [5, -1]], ANT_MOTORS, [[0, -1], [1, -1], [2, -1]]),
    "actuator_gear": (np.eye(6)[0], 30 * np.eye(6)[0], np.eye(6)[0]),
    "actuator_gainprm": np.eye(10)[0],
    "actuator_ctrlrange": ([-2, 2], [-1, 1], [-2, 2]),
    "actuator_ctrllimited": 1,
    "actuator_forcelimited": 0,
}


@pytest.fixture(params=FACTS)
def robot(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def facts(robot: str) -> Facts:
    return FACTS[robot]


@pytest.fixture
def model(robot: str) -> mujoco.MjModel:
    return load_model(robot)


def test_numbers(model: mujoco.MjModel, robot: str) -> None:
    for name, given in NUMBERS.items():
        expected = given[list(FACTS).index(robot)] if isinstance(given, tuple) else given
        value = np.asarray(attrgetter(name)(model))
        wanted = np.broadcast_to(np.asarray(expected, float), value.shape)
        np.testing.assert_allclose(value, wanted, rtol=1e-15, atol=1e-16, err_msg=name)
    if robot == "blockpush":
        assert model.opt.iterations == 20
    if robot != "ant":  # which stands on its feet in its keyframe
        assert not model.qpos0.any()


def test_order_of_coordinates_and_parts(model: mujoco.MjModel, facts: Facts) -> None:
    counts = {
        KINDS.mjOBJ_JOINT: model.njnt,
        KINDS.mjOBJ_GEOM: model.ngeom,
        KINDS.mjOBJ_BODY: model.nbody,
        KINDS.mjOBJ_ACTUATOR: model.nu,
    }
    for kind, expected in facts.names.items():
        assert names(model, kind, counts[kind]) == expected


def test_masses(model: mujoco.MjModel, facts: Facts) -> None:
    for index in range(model.nbody):
        body = model.body(index)
        assert body.mass[0] == pytest.approx(facts.masses.get(body.name, 0.0), rel=1e-12)
    assert model.body_subtreemass[0] == pytest.approx(sum(facts.masses.values()), rel=1e-12)


def test_masses_are_those_of_the_description() -> None:
    assert pytest.approx([4.989, 2.612], abs=5e-4) == [CAR_MASS, WHEEL_MASS]
    assert sum(ANT.masses.values()) == pytest.approx(0.911, abs=5e-4)
    assert pytest.approx(0.006, abs=5e-4) == GRIPPER_MASS
    assert pytest.approx(1.8e-7, rel=1e-12) == BLOCK_MASS


def test_inertia_is_that_of_uniform_bodies(model: mujoco.MjModel, facts: Facts) -> None:
    for name, expected in facts.inertias.items():
        found = inertia_tensor(model, name)
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-15 * expected.max())


def test_sizes_and_places_in_the_world(model: mujoco.MjModel, facts: Facts) -> None:
    data = at_rest(model)
    for name, (kind, size, place) in facts.geoms.items():
        assert model.geom(name).type[0] == kind
        np.testing.assert_allclose(model.geom(name).size[: len(size)], size, rtol=1e-12)
        np.testing.assert_allclose(data.geom(name).xpos, place, atol=1e-15)
    for name, place in facts.bodies.items():
        np.testing.assert_allclose(data.body(name).xpos, place, atol=1e-15)


def test_what_can_be_touched(model: mujoco.MjModel, facts: Facts) -> None:
    meets = (model.geom_contype[:, None] & model.geom_conaffinity[None]) != 0
    apart = np.array(facts.untouched)
    if facts is BLOCKPUSH:  # nothing touches the table
        expected = ~apart[:, None] & ~apart[None]
    else:  # only the floor can be touched
        expected = ~(apart[:, None] & apart[None])
    np.testing.assert_array_equal(meets | meets.T, expected)


def test_axles_and_arms_lie_where_they_belong() -> None:
    expected = {"wheeled": dict.fromkeys(WHEELS, Y)}
    expected["blockpush"] = {name: direction for name, (_, direction, _) in CAPSULES.items()}
    for robot, axes in expected.items():
        data = at_rest(load_model(robot))
        for name, axis in axes.items():
            along = data.geom(name).xmat.reshape(3, 3)[:, 2]
            np.testing.assert_allclose(np.abs(along), axis, atol=1e-12)
            if name in WHEELS:  # it turns about its own middle
                np.testing.assert_allclose(data.joint(name).xanchor, data.geom(name).xpos)


def at_rest(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


def test_the_margin_of_a_contact_of_the_ant_is_the_experiments() -> None:
    """Whether the engine adds up the margins of what touches or takes the larger one."""
    model = load_model("ant")
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[2] = 0.2
    mujoco.mj_forward(model, data)
    assert data.ncon == 5
    np.testing.assert_array_equal(data.contact.includemargin, np.full(5, 0.01))
    # The larger friction of the two: sliding in both directions, spinning, rolling.
    np.testing.assert_array_equal(data.contact.friction, np.tile([1, 1, 0.5, 0.5, 0.5], (5, 1)))


def test_the_file_itself_switches_automatic_resets_off(robot: str) -> None:
    text = text_of(robot)
    flags = mujoco.MjModel.from_xml_string(text).opt.disableflags
    assert flags & mujoco.mjtDisableBit.mjDSBL_AUTORESET
    assert "settotalmass" not in text


def test_looks_have_no_effect_on_the_dynamics(robot: str, model: mujoco.MjModel) -> None:
    bare = without_looks(robot)
    assert (bare.nsite, bare.nmocap, bare.nmat, bare.ncam, bare.nlight) == (0, 0, 0, 0, 0)
    np.testing.assert_array_equal(driven(bare), driven(model))


def driven(model: mujoco.MjModel) -> np.ndarray:
    """States under random controls."""
    stream, data = np.random.default_rng(1), mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    states = []
    for _ in range(200):
        # Forwards on the whole, where blocks are.
        data.ctrl[:] = model.actuator_ctrlrange[0, 1] * stream.uniform(-0.5, 1, size=model.nu)
        mujoco.mj_step(model, data)
        states.append(np.concatenate([data.qpos, data.qvel]))
    return np.stack(states)
