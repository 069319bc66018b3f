"""The accelerator's engine against the native one."""

import numpy as np
from playing import play

from maesn.envs import Wheeled, wheeled

TASKS = wheeled.task_set("test")


TASK_INDEX = [17, 3]


def test_the_wheeled_robot_drives_as_on_the_native_engine() -> None:
    env = Wheeled(horizon=100)
    native, mjx = (play(env, TASKS, TASK_INDEX, engine=engine) for engine in ("native", "mjx"))
    # The same draws, and physics that differ in the sixth digit: a second later, in the third.
    np.testing.assert_array_equal(mjx.noise, native.noise)
    np.testing.assert_array_equal(mjx.observation[..., 0, :], native.observation[..., 0, :])
    np.testing.assert_allclose(mjx.observation, native.observation, atol=0.02)
    np.testing.assert_allclose(mjx.reward.sum(-1), native.reward.sum(-1), atol=0.02)
    assert np.abs(mjx.observation[..., -1, :2]).max() > 0.1  # they do move
