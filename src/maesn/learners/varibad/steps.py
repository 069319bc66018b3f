"""The steps of trials as inference sees them, and a buffer of the last trials."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.experience.episodes import Episodes
from maesn.numerics import Ring


class Steps(NamedTuple):
    """Steps `[*batch, ...]` of trials, in their order; 0 where not valid."""

    observation: Float[Array, "*batch observation"]
    action: Float[Array, "*batch action"]
    reward: Float[Array, "*batch"]
    """The reward that the policy received."""
    next_observation: Float[Array, "*batch observation"]
    """What the action led to, at the end of an episode as well."""
    valid: Bool[Array, "*batch"]
    """True where the step was played, and what it led to is finite."""


def steps_of(episodes: Sequence[Episodes]) -> Steps:
    """Return the steps `[trial, time, ...]` of whole trials.

    Args:
        episodes: the first, second, ... episode of every trial, `[task, episode, time, ...]`.
    """
    parts = [_steps(one) for one in episodes]
    joined = [jnp.concatenate(arrays, axis=2) for arrays in zip(*parts, strict=True)]
    return Steps(*(x.reshape(-1, *x.shape[2:]) for x in joined))


def _steps(episodes: Episodes) -> Steps:
    before, after = episodes.observation[..., :-1, :], episodes.observation[..., 1:, :]
    valid = episodes.valid & jnp.isfinite(after).all(-1)

    def numbers(x: Array) -> Array:
        return jnp.where(valid[..., None] if x.ndim > valid.ndim else valid, x, 0.0)

    return Steps(
        numbers(before),
        numbers(episodes.action),
        numbers(episodes.received_reward),
        numbers(after),
        valid,
    )


def empty_buffer(capacity: int, time: int, observation_size: int, action_size: int) -> Ring:
    """Return a ring without trials, whose rows are whole trials of `time` steps."""
    observation, number = jnp.zeros((time, observation_size)), jnp.zeros(time)
    action = jnp.zeros((time, action_size))
    return Ring.empty(capacity, Steps(observation, action, number, observation, number > 0))
