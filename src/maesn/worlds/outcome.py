"""Evaluate an environment's functions on recorded states: observations, rewards, ends."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.axes import ObservedReward, Readings
from maesn.envs.base import AnyEnv, Reward


def observe(env: AnyEnv, readings: Readings, task: Any) -> Float[Array, " observation"]:
    """Return a policy's observation of a state, followed by the instruction if there is one."""
    return jnp.concatenate([env.observe(readings), env.instruction(task)])


def ends(env: AnyEnv, readings: Readings) -> Bool[Array, ""]:
    """Whether an episode ends in this state, by the task's rules or by a time limit of its own."""
    return env.terminated(readings) | env.truncated(readings)


def judge(
    env: AnyEnv,
    received: ObservedReward,
    readings: Readings,
    action: Float[Array, "time action"],
    task: Any,
) -> tuple[Array, Reward, Array, Array, Array, Array]:
    """Return what an episode shows and how it fares.

    These are observations, rewards, rewards as the policy receives them, `solved`, `ended` and
    `terminated`. Rewards are `[time]`; observations, `solved` and `ended` are `[time_plus_1]`.
    `ended` says whether the episode has ended at or before a state; `terminated`, one number,
    whether it ended by the task's rules and not by a time limit alone.
    """
    before = jax.tree.map(lambda x: x[:-1], readings)
    after = jax.tree.map(lambda x: x[1:], readings)
    observation = jax.vmap(lambda r: observe(env, r, task))(readings)
    reward = jax.vmap(lambda r, a, n: env.reward(r, a, n, task))(before, action, after)
    observed = jax.vmap(lambda r, a, n: env.observed_reward(received, r, a, n, task))(
        before, action, after
    )
    solved = jax.vmap(lambda r: env.solved(r, task))(readings)
    over = jax.vmap(partial(ends, env))(readings)
    terminated = env.terminated(jax.tree.map(lambda x: x[jnp.argmax(over)], readings))
    return observation, reward, observed, solved, jnp.cumsum(over) > 0, terminated
