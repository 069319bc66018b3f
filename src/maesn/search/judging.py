"""Returns of episodes in other tasks than those that they were played in."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from maesn.axes import Readings
from maesn.envs import AnyEnv, TaskSet


def situations(env: AnyEnv, tasks: TaskSet) -> list[np.ndarray]:
    """Return the indices of tasks that can share episodes, because only their rewards differ."""
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(jax.vmap(env.situation)(tasks.tasks))]
    groups: dict[bytes, list[int]] = {}
    for index in range(len(tasks)):
        content = b"|".join(leaf[index].tobytes() for leaf in leaves)
        groups.setdefault(content, []).append(index)
    return [np.asarray(group) for group in groups.values()]


@partial(jax.jit, static_argnums=0)
def returns_under(
    env: AnyEnv,
    readings: Readings,
    action: Float[Array, "simulation time action"],
    valid: Bool[Array, "simulation time"],
    tasks: Any,
) -> Float[Array, "task simulation"]:
    """Compute the undiscounted returns that episodes would have in other tasks of their situation.

    Args:
        env: the environment, with the reward to use.
        readings: readings of the episodes, `[time_plus_1, simulation, ...]` each.
        action: the policy's actions.
        valid: true where a step was played.
        tasks: the tasks, stacked.
    """
    before = jax.tree.map(lambda x: jnp.moveaxis(x[:-1], 0, 1), readings)
    after = jax.tree.map(lambda x: jnp.moveaxis(x[1:], 0, 1), readings)

    def in_task(task: Any) -> Array:
        def step(r: Readings, a: Array, n: Readings) -> Array:
            return env.reward(r, a, n, task).total

        return jnp.where(valid, jax.vmap(jax.vmap(step))(before, action, after), 0.0).sum(-1)

    returns: Array = jax.lax.map(in_task, tasks)
    return returns
