"""Episodes that a model of the dynamics can learn from."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from maesn.experience.episodes import Episodes
from maesn.numerics import DiagonalGaussian


def episodes_of(observation: np.ndarray, action: np.ndarray, **changes: Any) -> Episodes:
    """Return episodes without reward.

    Args:
        observation: `[*batch, time_plus_1, observation]`.
        action: `[*batch, time, action]`.
        changes: other fields than those of episodes that last to the end.
    """
    batch, shape = action.shape[:-2], action.shape[:-1]
    zeros = jnp.zeros(action.shape)
    fields = {
        "observation": jnp.asarray(observation, float),
        "action": jnp.asarray(action, float),
        "reward": jnp.zeros(shape),
        "goal_reward": jnp.zeros(shape),
        "valid": jnp.ones(shape, bool),
        "solved": jnp.zeros(shape, bool),
        "solved_at_start": jnp.zeros(batch, bool),
        "terminated": jnp.zeros(batch, bool),
        "noise": jnp.zeros((*batch, 0)),
        "description": jnp.zeros((*batch, 0)),
        "z": jnp.zeros((*batch, 0)),
        "behaviour": DiagonalGaussian(zeros, zeros),
        "trial_end": None,
    }
    return Episodes(**fields | changes)


def linear_episodes(
    seed: int, batch: tuple[int, ...], time: int, noise: float = 0.3, scale: float = 1.0
) -> Episodes:
    """Return a walk of two components whose change is linear in observation and action."""
    rng = np.random.default_rng(seed)
    action = scale * rng.normal(size=(*batch, time, 1))
    observation = np.zeros((*batch, time + 1, 2))
    observation[..., 0, :] = rng.normal(size=(*batch, 2))
    pull, push = np.array([[-0.4, 0.2], [0.1, -0.3]]), np.array([[0.8, -0.5]])
    for t in range(time):
        change = observation[..., t, :] @ pull + action[..., t, :] @ push
        change += noise * rng.normal(size=change.shape)
        observation[..., t + 1, :] = observation[..., t, :] + change
    return episodes_of(observation, action)
