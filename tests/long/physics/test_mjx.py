"""`MjxEngine` against plain MuJoCo: in double precision where the mathematics is judged.

Tolerances state what was measured, with a margin of about ten.
"""

from pathlib import Path

import jax.numpy as jnp
import mujoco
import numpy as np
from physics.accelerated import ROD, one_step_errors, quickly
from physics.plain import controls, plain_episodes, start
from physics.robots import ants_near_the_ground
from physics.test_native import masses

from maesn.physics import load_model
from maesn.physics.mjx import READABLE, MjxEngine

READINGS = ("qpos", "qvel", "subtree_com")
WHEELED = (start()[0][:4], start()[1][:4], controls()[:20, :4])


def test_the_wheeled_robot_takes_the_same_steps(x64: None) -> None:
    engine = MjxEngine("wheeled", READINGS, frame_skip=2)
    errors = one_step_errors(engine, "wheeled", *WHEELED, frame_skip=2)
    # The solver of either engine may stop anywhere within its tolerance of 1e-8.
    assert errors["qpos"].max() < 1e-6
    assert errors["qvel"].max() < 1e-4
    assert np.median(errors["qvel"]) < 1e-12
    assert errors["subtree_com"].max() < 1e-6  # of the returned state: it moves 1e-3 m in a substep


def test_single_precision_keeps_five_digits() -> None:
    errors = one_step_errors(MjxEngine("wheeled"), "wheeled", *WHEELED)
    assert errors["qpos"].max() < 3e-5
    assert errors["qvel"].max() < 3e-3


def test_the_ant_takes_the_same_steps(x64: None) -> None:
    control = np.random.default_rng(3).uniform(-1, 1, size=(3, 3, 8))
    errors = one_step_errors(MjxEngine("ant"), "ant", *ants_near_the_ground(), control)
    assert errors["qpos"].max() < 1e-5
    assert errors["qvel"].max() < 1e-4
    assert errors["qvel"][:, 2].max() < 1e-8  # in the air, where no solver takes part


def test_block_pushing_takes_the_same_steps_where_faces_meet(x64: None) -> None:
    # The end of the right arm before the middle of a block's face, the other blocks out of reach.
    # The two margins of 2 mm begin to count at 4 mm: no, yes, yes.
    gaps = np.array([0.05, 0.003, -0.001])
    places = np.tile([[5.0, 0.0], [5.0, 1.0], [0.0, 0.0], [5.0, 3.0], [5.0, 4.0]], (3, 1, 1))
    places[:, 2] = np.stack([0.12 + gaps + 0.03, np.full(3, -0.1)], axis=1)
    homes = np.array([[0.2, 0.0], [0.4, 0.0], [0.6, 0.0], [0.8, 0.0], [1.0, 0.0]])
    qpos = np.concatenate([np.zeros((3, 3)), (places - homes).reshape(3, 10)], axis=1)
    qvel = np.zeros((3, 13))
    qvel[:, 0] = 0.2
    control = np.random.default_rng(4).uniform(-2, 2, size=(2, 3, 3))
    control[..., 0] = np.abs(control[..., 0])  # forwards
    errors = one_step_errors(MjxEngine("blockpush"), "blockpush", qpos, qvel, control)
    assert errors["qpos"].max() < 1e-9
    assert errors["qvel"].max() < 1e-9
    after = plain_episodes([load_model("blockpush")] * 3, qpos, qvel, control[:1], ("qvel",))[-1]
    assert list(after["qvel"][:, 7] > 1e-3) == [False, True, True]


def test_fields_change_the_dynamics_and_what_follows_from_them(x64: None) -> None:
    fields, models = masses(load_model("wheeled"))
    chosen = [0, 3, 7, 11]
    fields = {name: values[chosen] for name, values in fields.items()}
    models = [models[index] for index in chosen]
    for model in models:
        mujoco.mj_setConst(model, mujoco.MjData(model))
    engine, (qpos, qvel, control) = MjxEngine("wheeled"), WHEELED
    state, readings = quickly(engine.initial)(
        jnp.asarray(qpos), jnp.asarray(qvel), engine.dynamics(fields)
    )
    step, got = quickly(engine.step), [readings]
    for row in control[:10]:
        state, readings = step(state, jnp.asarray(row))
        got.append(readings)
    expected = plain_episodes(models, qpos, qvel, control[:10], ("qpos", "qvel"))
    for one, other in zip(got, expected, strict=True):
        np.testing.assert_allclose(one["qpos"], other["qpos"], atol=1e-6)
    # So that the comparison means something: the same start without the fields ends elsewhere.
    own = plain_episodes([load_model("wheeled")] * 4, qpos, qvel, control[:10], ("qpos", "qvel"))
    assert np.abs(own[-1]["qvel"] - expected[-1]["qvel"]).max() > 0.01
    assert {name for name in engine.dynamics(fields) if "invweight0" in name}


def push(model: Path | str, distances: np.ndarray) -> dict[str, np.ndarray]:
    """Push a rod into a block's face from these distances, for three steps."""
    qpos = np.stack([distances, np.full(len(distances), 0.01), np.zeros(len(distances))], axis=1)
    qvel = np.tile([0.2, 0.0, 0.0], (len(distances), 1))
    return one_step_errors(MjxEngine(model), model, qpos, qvel, np.zeros((3, len(distances), 0)))


def test_margins_count_at_boxes(tmp_path: Path, x64: None) -> None:
    path = tmp_path / "rod.xml"
    rod = 'type="capsule" size="0.02" fromto="0 0 0 0.08 0 0" mass="1"'
    path.write_text(ROD.format(rod=rod), encoding="utf-8")
    # From a gap of 22 mm to an overlap of 1 mm; the two margins of 10 mm begin to count at 20 mm.
    distances = np.array([-0.002, 0.001, 0.01, 0.019, 0.021])
    assert push(path, distances)["qvel"].max() < 1e-9


def test_readings_are_those_of_mujoco(x64: None) -> None:
    qpos, qvel = ants_near_the_ground()
    engine = MjxEngine("ant", READABLE)
    _, got = quickly(engine.initial)(jnp.asarray(qpos), jnp.asarray(qvel), {})
    model = load_model("ant")
    assert set(got) == set(READABLE)
    touched = 0
    for simulation in range(len(qpos)):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = qpos[simulation], qvel[simulation]
        mujoco.mj_forward(model, data)
        mujoco.mj_rnePostConstraint(model, data)
        touched += data.ncon
        for name in READABLE:
            expected = np.asarray(getattr(data, name))
            assert got[name].shape[1:] == expected.shape
            scale = max(1.0, np.abs(expected).max(initial=0.0))
            np.testing.assert_allclose(
                got[name][simulation], expected, atol=1e-5 * scale, err_msg=name
            )
    assert touched > 2  # so that the forces between bodies mean something
