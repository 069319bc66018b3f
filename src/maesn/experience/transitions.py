"""Transitions of a world, to fit a model of its dynamics to."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.experience.episodes import Episodes

# Standard deviations beyond which inputs and changes are cut off: contacts have heavy tails.
FEATURE_CLIP = 10.0


class Transitions(NamedTuple):
    """Transitions of all episodes, one after another."""

    rows: Float[Array, "transition feature"]
    """Observation, action, and change of the observation, side by side."""
    valid: Bool[Array, " transition"]
    """False for steps beyond the end of an episode, and where an observation is not finite."""


class Scale(NamedTuple):
    """Mean and standard deviation of each feature of the pool."""

    mean: Float[Array, " feature"]
    std: Float[Array, " feature"]

    def __call__(self, row: Float[Array, " feature"]) -> Float[Array, " feature"]:
        """Return the standardised features of one transition."""
        return jnp.clip((row - self.mean) / self.std, -FEATURE_CLIP, FEATURE_CLIP)


def transitions(episodes: Episodes) -> Transitions:
    """Return the transitions of all steps of all episodes."""
    before, after = episodes.observation[..., :-1, :], episodes.observation[..., 1:, :]
    finite = jnp.isfinite(before).all(-1) & jnp.isfinite(after).all(-1)
    rows = jnp.concatenate([before, episodes.action, after - before], axis=-1)
    return Transitions(rows.reshape(-1, rows.shape[-1]), (episodes.valid & finite).reshape(-1))
