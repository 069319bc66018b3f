"""All that `MjxEngine` says it can read, against MuJoCo: ants in the air and on their feet."""

import jax.numpy as jnp
import mujoco
import numpy as np
from physics.accelerated import quickly
from physics.robots import ants_near_the_ground

from maesn.physics import load_model
from maesn.physics.mjx import READABLE, MjxEngine


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
