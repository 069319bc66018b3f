"""What follows the end of an episode may be anything, and harms nothing."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from carts import RUNAWAY, CartTask, cart_on
from playing import play

from maesn.envs import TaskSet
from maesn.physics import NativeSimulator, PhysicsError

EPISODES = 5
LIMIT = 100.0  # m/s


def runaway(directory: Path) -> type:
    """The cart whose speed grows tenfold a step, and whose episode ends beyond the limit."""

    class Stopped(cart_on(directory, RUNAWAY)):  # type: ignore[misc]
        def control(self, action: jax.Array) -> jax.Array:
            return action[:1] * 0.0  # NaN of an action that is not a number

        def terminated(self, readings: Any) -> jax.Array:
            return jnp.abs(readings["qvel"][0]) > LIMIT

    return Stopped


def test_physics_that_blows_up_after_the_end_is_no_error(tmp_path: Path) -> None:
    # v_t = 10^t m/s in the episodes that are pushed: the first above 100 is v_3, and the first
    # acceleration that MuJoCo warns of is met in step 8.
    env = runaway(tmp_path)(horizon=12)
    tasks = TaskSet(CartTask(np.float32([1, 0]), np.float32([1, 1])))
    episodes = play(env, tasks, [0, 1], episodes=EPISODES)
    pushed = np.asarray(episodes.observation[0, :, 0, 1]) == 1
    assert pushed.any()
    assert not pushed.all()
    np.testing.assert_array_equal(episodes.valid[0].sum(-1), np.where(pushed, 3, 12))
    np.testing.assert_array_equal(episodes.terminated[0], pushed)
    assert np.all(episodes.valid[1])
    # Nobody else is disturbed by those that go on to infinity.
    np.testing.assert_array_equal(episodes.observation[1], np.zeros((EPISODES, 13, 2)))
    speed = np.abs(np.asarray(episodes.observation[0, :, -1, 1]))
    assert not (speed[pushed] < 1e8).any()


def test_only_abandoned_simulations_may_blow_up() -> None:
    simulator = NativeSimulator("wheeled", 3)
    speeds = np.zeros((3, 6))
    speeds[[0, 2], 3] = 9e9
    controls, nobody = np.zeros((3, 2)), np.zeros(3, bool)
    simulator.reset(np.zeros((3, 6)), speeds)
    for _ in range(20):
        readings = simulator.step(controls, abandoned=np.array([True, False, True]))
    assert np.abs(readings["qvel"][1]).max() < 1.0
    for abandoned, failed in ((np.array([True, False, False]), 2), (nobody, 0)):
        with pytest.raises(PhysicsError) as caught:
            simulator.step(controls, abandoned=abandoned)
        assert caught.value.simulation == failed
