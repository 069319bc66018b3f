"""Goals: their reward (the paper's appendix "Reward Functions"), and where they lie."""

from collections.abc import Callable
from functools import partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maesn.envs.base import AnyEnv, RewardKind
from maesn.envs.tasks import TaskFamily

# Radii that no training goal has, as multiples of the one that all of them have.
NEARER_RADII = (0.6, 0.8)
FARTHER_RADII = (1.2, 1.4)


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


def draw_half_circle(stream: np.random.Generator, size: int, radius: float) -> np.ndarray:
    """Draw `size` goals on the upper half circle, angles uniform on [0, 180) degrees."""
    angle = stream.uniform(0.0, np.pi, size)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1).astype(np.float32)


def draw_unfamiliar_goals(stream: np.random.Generator, size: int, radius: float) -> np.ndarray:
    """Draw goals unlike those of `draw_half_circle`, for tests of generalisation.

    By turns: on the lower half of the same circle, an arc held out of training; on the upper half
    but nearer; on the upper half but farther.
    """
    kind = np.arange(size) % 3
    angle = stream.uniform(0.0, np.pi, size) + np.where(kind == 0, np.pi, 0.0)
    nearer = stream.uniform(*NEARER_RADII, size)
    farther = stream.uniform(*FARTHER_RADII, size)
    distance = radius * np.choose(kind, [np.ones(size), nearer, farther])
    return (distance * np.stack([np.cos(angle), np.sin(angle)])).T.astype(np.float32)


def half_circle_family(
    name: str, make_env: Callable[..., AnyEnv], radius: float, seed: int
) -> TaskFamily:
    """Return the family whose goals lie on a half circle.

    Args:
        name: name of the family.
        make_env: makes the environment; its tasks are goals.
        radius: radius of the half circle, in metres.
        seed: fixes the sets of the family.
    """
    return TaskFamily(
        name,
        make_env,
        partial(draw_half_circle, radius=radius),
        ("goal",),
        seed,
        draw_ood_tasks=partial(draw_unfamiliar_goals, radius=radius),
    )
