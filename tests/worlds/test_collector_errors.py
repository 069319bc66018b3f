"""Episodes that go wrong are named: environment, task, episode and step."""

import re
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from carts import RUNAWAY, CartTask, cart_on, pushed
from learning_problems.probes import DelayedTarget
from playing import agents, keys, play

from maesn.envs import Reward, TaskSet, Wheeled, wheeled
from maesn.worlds import EpisodeError

EPISODES = 5


def failure_of(expected: str) -> Any:
    return pytest.raises(EpisodeError, match=re.escape(expected))


def test_physics_that_blows_up(tmp_path: Path) -> None:
    # Task 1 is the only one with a speed, v_0 = 1 m/s, in the episodes that are pushed. The speed
    # grows tenfold a step and the acceleration is 900 v, so in step t it is 900 * 10^t: beyond
    # MuJoCo's limit of 1e10 first in step 8 (9e10; step 7 has 9e9).
    env = cart_on(tmp_path, RUNAWAY)()
    tasks = TaskSet(CartTask(np.float32([0, 1, 0]), np.float32([1, 1, 1])))
    seed = 2
    start_keys = [
        jax.random.split(jax.random.fold_in(keys(2, seed)[1], episode), 3)[1]
        for episode in range(EPISODES)
    ]
    episode = [bool(pushed(key)) for key in start_keys].index(True)
    assert episode > 0  # otherwise the test could not tell it from a default
    with failure_of(f"cart, task 1, episode {episode}, step 8: MuJoCo warns: ") as error:
        play(env, tasks, [2, 1], episodes=EPISODES, seed=seed)
    assert "QACC" in str(error.value)
    # The simulators go on to serve whoever behaves.
    calm = play(env, tasks, [2, 0], episodes=EPISODES, seed=seed)
    np.testing.assert_array_equal(calm.observation, np.zeros_like(calm.observation))


def test_an_action_that_is_not_a_number_reaches_no_engine() -> None:
    # Only task 40's slot has a latent that is not finite, so only its actions are not.
    env = Wheeled(horizon=4)
    cast = agents(env, 2)
    cast = eqx.tree_at(lambda x: x.context.mean, cast, cast.context.mean.at[1].set(jnp.nan))
    with failure_of("wheeled, task 40, episode 0, step 0: `control` must be finite"):
        play(env, wheeled.task_set("test"), [7, 40], episodes=EPISODES, cast=cast)


class RewardIsNaN(DelayedTarget):
    """Forgets what the fifth step is worth if the target is on the left and a_0 on the right."""

    def reward(self, readings: Any, action: Any, next_readings: Any, task: Any) -> Reward:
        steps, named, _ = next_readings["qpos"]
        forgets = (steps == 5) & (task[0] < 0) & (named > 0)
        return Reward(jnp.where(forgets, jnp.nan, 0.0), jnp.zeros(()))


def test_a_reward_that_is_not_a_number() -> None:
    tasks, seed = TaskSet(np.float32([[1, 0], [-1, 0], [0, 1]])), 1
    known = play(DelayedTarget(), tasks, [0, 2, 1], episodes=EPISODES, seed=seed)
    right = np.asarray(known.action[2, :, 0, 0]) > 0
    episode = int(np.argmax(right))
    assert episode > 0
    where = f"delayed_target, task 1, episode {episode}, step 4"
    with failure_of(f"{where}: the reward is not finite"):
        play(RewardIsNaN(), tasks, [0, 2, 1], episodes=EPISODES, seed=seed)


class Unseen(DelayedTarget):
    """Sees nothing sensible in its third state."""

    def observe(self, readings: Any) -> Any:
        return jnp.where(readings["qpos"][0] == 2, jnp.inf, super().observe(readings))


def test_an_observation_that_is_not_a_number() -> None:
    tasks = TaskSet(np.float32([[1, 0], [-1, 0]]))
    with failure_of("delayed_target, task 1, episode 0, step 2: the observation is not finite"):
        play(Unseen(), tasks, [1], episodes=EPISODES)


def test_a_policy_that_is_not_a_number() -> None:
    env = DelayedTarget()
    cast = agents(env, 1)
    cast = eqx.tree_at(lambda x: x.policy.log_std, cast, jnp.full(2, jnp.nan))
    with failure_of("delayed_target, task 0, episode 0, step 0: the action is not finite"):
        play(env, TaskSet(np.float32([[1, 0]])), [0], episodes=EPISODES, cast=cast)
