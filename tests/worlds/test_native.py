"""Episodes of the native engine against plain loops over `mujoco.mj_step` and a closed form."""

from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from carts import MOTOR, TIME_STEP, CartTask, cart_on, pushed
from playing import agents, assert_same, keys, play

from maesn.envs import TaskSet, Wheeled, wheeled
from maesn.episodes import Episodes
from maesn.physics import load_model
from maesn.worlds import NativeWorld, make_world

TASKS = wheeled.task_set("test")
TASK_INDEX = [17, 3]
EPISODES = 3


ENV = Wheeled(reward_kind="sparse")


@pytest.fixture(scope="module")
def episodes() -> Episodes:
    return play(ENV, TASKS, TASK_INDEX, episodes=EPISODES, num_threads=1)


def simulate(start: np.ndarray, controls: np.ndarray) -> np.ndarray:
    """The states that MuJoCo passes through, `[time_plus_1, 12]`."""
    model = load_model("wheeled")
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start[:6], start[6:]
    states = [start]
    for control in controls:
        data.ctrl[:] = control
        mujoco.mj_step(model, data)
        states.append(np.concatenate([data.qpos, data.qvel]))
    return np.stack(states)


@pytest.mark.parametrize("slot", range(len(TASK_INDEX)))
@pytest.mark.parametrize("episode", range(EPISODES))
def test_states_equal_those_of_a_plain_loop(episodes: Episodes, slot: int, episode: int) -> None:
    seen = np.asarray(episodes.observation[slot, episode])
    # The start comes from the keys that the rollout documents.
    key = jax.random.fold_in(keys(len(TASK_INDEX))[slot], episode)
    task = jnp.asarray(TASKS[TASK_INDEX[slot]])
    start = np.concatenate(ENV.initial(jax.random.split(key, 3)[1], task))
    np.testing.assert_allclose(seen[0], start, rtol=1e-5)
    # All other states follow bit for bit, in the single precision that episodes are kept in.
    actions = np.asarray(episodes.action[slot, episode])
    states = simulate(seen[0].astype(np.float64), np.clip(2 * actions, -2, 2))
    np.testing.assert_array_equal(seen, states.astype(np.float32))


def test_rewards_follow_from_the_states(episodes: Episodes) -> None:
    place = np.asarray(episodes.observation[..., 1:, :2], np.float64)
    goals = np.asarray(TASKS[np.array(TASK_INDEX)], np.float64)[:, None, None]
    distance = np.linalg.norm(place - goals, axis=-1)
    np.testing.assert_array_equal(episodes.solved, distance <= 0.8)
    goal = np.where(distance > 0.8, -2.0, -distance)
    cost = 0.05 * np.sum(np.clip(2 * np.asarray(episodes.action), -2, 2) ** 2, axis=-1)
    np.testing.assert_allclose(episodes.goal_reward, goal, atol=1e-5)
    np.testing.assert_allclose(episodes.reward, goal - cost, atol=1e-5)


def test_two_threads_give_the_same_episodes_as_one(episodes: Episodes) -> None:
    assert_same(episodes, play(ENV, TASKS, TASK_INDEX, episodes=EPISODES, num_threads=2))


def test_nothing_is_left_of_earlier_episodes(episodes: Episodes) -> None:
    # The same collector, and so the same simulator, in between in other tasks.
    play(ENV, TASKS, [5, 6], episodes=EPISODES, num_threads=1, seed=9)
    assert_same(episodes, play(ENV, TASKS, TASK_INDEX, episodes=EPISODES, num_threads=1))


def test_the_robots_do_move(episodes: Episodes) -> None:
    # Guards the tests above: robots at rest would agree as well.
    assert np.ptp(np.asarray(episodes.observation[..., :2])) > 0.5


def test_tasks_may_change_the_dynamics_of_a_users_own_model(tmp_path: Path) -> None:
    env = cart_on(tmp_path, MOTOR)(force=3.0)
    tasks = TaskSet(CartTask(np.float32([0.0, 5.0, 0.0]), np.float32([1.0, 2.0, 8.0])))
    task_index, count = [2, 0, 1], 4
    episodes = play(env, tasks, task_index, episodes=count, cast=agents(env, 3))
    steps = np.arange(env.horizon + 1)
    for slot, (key, index) in enumerate(zip(keys(3), task_index, strict=True)):
        for episode in range(count):
            start_key = jax.random.split(jax.random.fold_in(key, episode), 3)[1]
            task = tasks[index]
            first = float(task.speed) * bool(pushed(start_key))
            acceleration = 3.0 / float(task.mass)
            # v_t = v_0 + h a t and x_t = sum_{s = 1 ... t} h v_s = h v_0 t + h^2 a t (t + 1) / 2
            speed = first + TIME_STEP * acceleration * steps
            place = TIME_STEP * first * steps
            place = place + TIME_STEP**2 * acceleration * steps * (steps + 1) / 2
            expected = np.stack([place, speed], axis=-1)
            np.testing.assert_allclose(
                episodes.observation[slot, episode], expected, rtol=1e-5, atol=1e-7
            )


def test_mujoco_environments_are_played_natively() -> None:
    assert isinstance(make_world(Wheeled(), TASKS, num_threads=1), NativeWorld)
