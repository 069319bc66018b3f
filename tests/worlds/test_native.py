"""Episodes of the native engine against plain loops over `mujoco.mj_step` and a closed form."""

import functools
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from carts import MOTOR, TIME_STEP, CartTask, cart_on, pushed
from physics.by_hand import ROBOTS, Judged
from physics.plain import plain_episodes
from playing import agents, constant_agents, keys, play

from maesn.axes import Key
from maesn.envs import AbstractMujocoEnv, Ant, BlockPush, TaskSet, Wheeled, find_family
from maesn.experience.episodes import Episodes
from maesn.physics import load_model
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

TASK_INDEX = [17, 3]
EPISODES = 3


class LeapingAnt(Ant):
    """An ant that leaps into the air at the start of some episodes, which ends them there."""

    def initial(self, key: Key, task: Any) -> tuple[jax.Array, jax.Array]:
        qpos, qvel = super().initial(key, task)
        return qpos, qvel.at[2].add(jnp.where(jax.random.bernoulli(key), 4.0, 0.0))  # m/s


# Goal regions that some steps end in, and some do not.
WHEELED = Wheeled(reward_kind="sparse", sparse_radius=2.0)
ENVS = (
    WHEELED,
    LeapingAnt(reward_kind="sparse", sparse_radius=2.0),
    BlockPush(reward_kind="sparse", sparse_radius=0.4),
)


@functools.cache
def collector(env: AbstractMujocoEnv[Any], num_threads: int = 1) -> Collector:
    tasks = find_family(env.name).task_set("test")
    return Collector(make_world(env, tasks, num_threads), EPISODES)


def collect(env: AbstractMujocoEnv[Any], index: list[int], num_threads: int = 1) -> Any:
    """Episodes `[task, episode, ...]`, and the states `[time_plus_1, simulation, ...]`."""
    cast = agents(env, 2)
    if env.name == "blockpush":
        cast = constant_agents(env, 2, np.float32([0.5, 0.0, 0.0]), 0.5)  # to where the blocks are
    return collector(env, num_threads).play(keys(2), cast, jnp.asarray(index))


class Played(NamedTuple):
    """Episodes as the library plays and judges them, and as plain MuJoCo and NumPy do."""

    env: AbstractMujocoEnv[Any]
    tasks: list[Any]
    """Of each simulation."""
    episodes: Episodes
    """`[simulation, ...]`"""
    readings: dict[str, np.ndarray]
    """`[time_plus_1, simulation, ...]`"""
    plain: dict[str, np.ndarray]
    """The same, from the same starts and under the same actions, in double precision."""
    judged: list[Judged]
    """Of each simulation."""

    def lived(self, simulation: int) -> int:
        """How many steps MuJoCo and NumPy say that an episode has."""
        ends = np.flatnonzero(self.judged[simulation].ends)
        return int(ends[0]) if ends.size else self.env.horizon


@pytest.fixture(scope="module", params=ENVS, ids=lambda env: env.name)
def played(request: pytest.FixtureRequest) -> Played:
    env, robot = request.param, ROBOTS[request.param.name]
    episodes, readings = collect(env, TASK_INDEX)
    episodes = jax.tree.map(
        lambda leaf: np.asarray(leaf).reshape(len(TASK_INDEX) * EPISODES, *leaf.shape[2:]), episodes
    )
    tasks = [collector(env).world.tasks[index] for index in TASK_INDEX for _ in range(EPISODES)]
    control = np.clip(robot.scale * episodes.action, -robot.scale, robot.scale)
    start = (readings[name][0].astype(np.float64) for name in ("qpos", "qvel"))
    models = [load_model(env.model)] * len(tasks)
    moments = plain_episodes(models, *start, control.swapaxes(0, 1), robot.read)
    plain = {name: np.stack([moment[name] for moment in moments]) for name in robot.read}
    judged = [
        robot.judge({n: v[:, i] for n, v in plain.items()}, control[i], task, env.sparse_radius)
        for i, task in enumerate(tasks)
    ]
    return Played(env, tasks, episodes, readings, plain, judged)


def test_episodes_start_as_the_keys_say(played: Played) -> None:
    for simulation, task in enumerate(played.tasks):
        slot, episode = divmod(simulation, EPISODES)
        key = jax.random.split(jax.random.fold_in(keys(2)[slot], episode), 3)[1]
        expected = played.env.initial(key, jax.tree.map(jnp.asarray, task))
        for name, value in zip(("qpos", "qvel"), expected, strict=True):
            start = played.readings[name][0, simulation]
            np.testing.assert_allclose(start, value, rtol=1e-5, atol=1e-7)


def test_states_equal_those_of_a_plain_loop(played: Played) -> None:
    for simulation in range(len(played.tasks)):
        states = slice(played.lived(simulation) + 1)
        for name in played.env.readings:
            seen, plain = (x[name][states, simulation] for x in (played.readings, played.plain))
            # Bit for bit, in the single precision that episodes are kept in.
            np.testing.assert_array_equal(seen, plain.astype(np.float32), name)


def test_observations_rewards_and_ends_follow_from_the_states(played: Played) -> None:
    for simulation, judged in enumerate(played.judged):
        episode = jax.tree.map(lambda leaf, i=simulation: leaf[i], played.episodes)
        lived = played.lived(simulation)
        np.testing.assert_array_equal(episode.valid, np.arange(played.env.horizon) < lived)
        assert episode.terminated == judged.ends.any()
        seen = episode.observation[: lived + 1]
        np.testing.assert_allclose(seen, judged.observation[: lived + 1], rtol=1e-5, atol=1e-6)
        np.testing.assert_array_equal(episode.solved[:lived], judged.solved[:lived])
        goal, cost = judged.goal_reward[:lived], judged.cost[:lived]
        np.testing.assert_allclose(episode.goal_reward[:lived], goal, atol=1e-5)
        np.testing.assert_allclose(episode.reward[:lived], goal - cost, atol=1e-5)


def test_these_episodes_have_what_is_to_be_compared(played: Played) -> None:
    # Robots at rest would agree as well, and so would goals that nobody comes near.
    moving = slice(3, 13) if played.env.name == "blockpush" else slice(0, 2)
    assert np.ptp(played.plain["qpos"][..., moving], axis=0).max() > 0.2  # metres
    solved = np.concatenate([judged.solved for judged in played.judged])
    assert 0.05 < solved.mean() < 0.95
    ended = [judged.ends.any() for judged in played.judged]
    assert any(ended) == (played.env.name == "ant")
    assert not all(ended)


CARTS = TaskSet(CartTask(np.float32([0.0, 5.0, 0.0]), np.float32([1.0, 2.0, 8.0])))


def test_tasks_may_change_the_dynamics(tmp_path: Path) -> None:
    env = cart_on(tmp_path, MOTOR)(force=3.0)
    task_index, count = [2, 0, 1], 2
    cast = agents(env, 3)
    episodes = play(env, CARTS, task_index, episodes=count, cast=cast)
    steps = np.arange(env.horizon + 1)
    for slot, (key, index) in enumerate(zip(keys(3), task_index, strict=True)):
        for episode in range(count):
            start_key = jax.random.split(jax.random.fold_in(key, episode), 3)[1]
            first = float(CARTS[index].speed) * bool(pushed(start_key))
            change = TIME_STEP * 3.0 / float(CARTS[index].mass)
            # v_t = v_0 + h a t and x_t = sum_{s = 1 ... t} h v_s = h v_0 t + h^2 a t (t + 1) / 2
            speed = first + change * steps
            place = TIME_STEP * (first * steps + change * steps * (steps + 1) / 2)
            np.testing.assert_allclose(
                episodes.observation[slot, episode],
                np.stack([place, speed], axis=-1),
                rtol=1e-5,
                atol=1e-6,
            )
