"""Goal-reaching rewards of the paper's appendix "Reward Functions"."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from maesn.envs.base import RewardKind

Vector = Float[Array, " 2"]


def goal_reward(
    distance: Float[Array, ""],
    outside: Float[Array, ""] | float,
    reward_kind: RewardKind,
    sparse_radius: float,
) -> Float[Array, ""]:
    """Return the dense reward -distance, or its sparse form.

    Sparse: -distance where distance <= sparse_radius, and the uninformative constant
    `outside` elsewhere (appendix "Reward Functions").
    """
    if reward_kind == "dense":
        return -distance
    return jnp.where(distance > sparse_radius, outside, -distance)


def within(distance: Float[Array, ""], radius: float) -> Bool[Array, ""]:
    """Whether the goal region is reached."""
    return distance <= radius


def draw_half_circle(stream: np.random.Generator, size: int, radius: float) -> np.ndarray:
    """Draw `size` goals on the upper half circle, angles uniform on [0, 180) degrees."""
    angle = stream.uniform(0.0, np.pi, size)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1).astype(np.float32)
