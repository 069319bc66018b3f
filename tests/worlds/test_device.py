"""The compiled scan against a plain Python loop over steps, one episode at a time."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.probes import DelayedTarget, HiddenSide
from playing import agents, keys, play

from maesn.axes import Readings
from maesn.envs import AbstractPureEnv, Point, TaskSet
from maesn.experience.agent import Agents

GOALS = TaskSet(np.float32([[2.0, 0.0], [0.0, 2.0], [-1.2, 1.6]]))
SIDES = TaskSet(np.float32([-1.0, 1.0, 1.0]))
EPISODES = 2


def mean_action(cast: Agents, observation: Any, context: Any) -> np.ndarray:
    """The policy's network, in NumPy."""
    first, second = cast.policy.mlp.layers
    x = np.concatenate([observation, context])
    x = np.maximum(x @ np.asarray(first.weight) + np.asarray(first.bias), 0)
    return x @ np.asarray(second.weight) + np.asarray(second.bias)


def loop(
    env: AbstractPureEnv[Any], cast: Agents, slot: int, task: Any, key: jax.Array
) -> dict[str, Any]:
    """One episode, step by step, with the keys that the rollout documents."""
    context_key, start_key, action_key = jax.random.split(key, 3)
    noise = jax.random.normal(context_key, (2,))
    context = cast.context.mean[slot] + jnp.exp(cast.context.log_std[slot]) * noise
    qpos, qvel = env.initial(start_key, task)
    state, record = {"qpos": qpos, "qvel": qvel}, []
    draws = jax.random.normal(action_key, (env.horizon, env.action_size))
    for step in range(env.horizon):
        observation = env.observe(state)
        mean = mean_action(cast, observation, context)
        action = jnp.asarray(mean + draws[step])  # the standard deviation is 1
        following = env.advance(state, env.control(action))
        reward = env.reward(state, action, following, task)
        record.append(
            {
                "observation": observation,
                "action": action,
                "reward": reward.goal + reward.other,
                "goal_reward": reward.goal,
                "solved": env.solved(following, task),
            }
        )
        state = following
    stacked = jax.tree.map(lambda *steps: np.stack(steps), *record)
    last = env.observe(state)[None]
    stacked["observation"] = np.concatenate([stacked["observation"], last])
    return {**stacked, "noise": noise, "z": context}


@pytest.mark.parametrize(
    ("env", "tasks"),
    [
        (Point(horizon=5), GOALS),
        (Point(horizon=5, reward_kind="sparse", sparse_radius=1.9, variant="paper"), GOALS),
        (DelayedTarget(horizon=4), GOALS),
        (HiddenSide(horizon=4, sparse_radius=1.0), SIDES),
    ],
    ids=["point", "sparse-point", "delayed-target", "hidden-side"],
)
def test_a_batch_equals_a_plain_loop(env: AbstractPureEnv[Any], tasks: TaskSet) -> None:
    cast, task_index = agents(env, 3), [2, 0, 1]
    episodes = play(env, tasks, task_index, episodes=EPISODES, cast=cast)
    for slot, (key, index) in enumerate(zip(keys(3), task_index, strict=True)):
        for episode in range(EPISODES):
            task = jnp.asarray(tasks[index])
            expected = loop(env, cast, slot, task, jax.random.fold_in(key, episode))
            for name, value in expected.items():
                got = np.asarray(getattr(episodes, name)[slot, episode])
                np.testing.assert_allclose(got, value, rtol=1e-4, atol=1e-5, err_msg=name)


class Shifted(Point):
    """A user's environment that holds an array."""

    shift: np.ndarray = eqx.field(default_factory=lambda: np.zeros(2, np.float32))

    def observe(self, state: Readings) -> jax.Array:
        return super().observe(state) + self.shift


def test_an_environment_may_hold_arrays() -> None:
    first, same, other = Shifted(), Shifted(), Shifted(shift=np.ones(2, np.float32))
    assert first == same
    assert hash(first) == hash(same)
    assert first != other
    seen = [play(env, GOALS, [0, 1, 2]).observation for env in (first, same, other)]
    np.testing.assert_array_equal(seen[0], seen[1])
    assert (np.asarray(seen[2])[:, :, 0] != np.asarray(seen[0])[:, :, 0]).all()
