"""Goals: their reward (the paper's appendix "Reward Functions"), and where they lie."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maesn.envs.base import AnyEnv, RewardKind
from maesn.envs.tasks import SetName, TaskFamily


class Radii(NamedTuple):
    """Ranges of the radii of unfamiliar goals, as multiples of the one that all others have."""

    behind: tuple[float, float]
    nearer: tuple[float, float]
    farther: tuple[float, float]


UNFAMILIAR: Mapping[SetName, Radii] = {
    "ood": Radii(behind=(1.0, 1.0), nearer=(0.6, 0.8), farther=(1.2, 1.4)),
    "ood-validation": Radii(behind=(0.6, 1.2), nearer=(0.45, 0.9), farther=(1.05, 1.5)),
}
"""Sets of tasks unlike those of training: one to report on, one to choose on."""


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


def draw_unfamiliar_goals(
    stream: np.random.Generator, size: int, radius: float, radii: Radii
) -> np.ndarray:
    """Draw goals unlike those of `draw_half_circle`, for tests of generalisation.

    By turns: behind, on the lower half of the circle, an arc held out of training; on the upper
    half but nearer; on the upper half but farther.
    """
    kind = np.arange(size) % 3
    angle = stream.uniform(0.0, np.pi, size) + np.where(kind == 0, np.pi, 0.0)
    nearer = stream.uniform(*radii.nearer, size)
    farther = stream.uniform(*radii.farther, size)
    behind = stream.uniform(*radii.behind, size)
    distance = radius * np.choose(kind, [behind, nearer, farther])
    return (distance * np.stack([np.cos(angle), np.sin(angle)])).T.astype(np.float32)


def half_circle_family(
    name: str, make_env: Callable[..., AnyEnv], radius: float, seed: int
) -> TaskFamily:
    """Return the family whose tasks are goals on a half circle of that radius, in metres."""
    return TaskFamily(
        name,
        make_env,
        partial(draw_half_circle, radius=radius),
        ("goal",),
        seed,
        draw_unfamiliar={
            name: partial(draw_unfamiliar_goals, radius=radius, radii=radii)
            for name, radii in UNFAMILIAR.items()
        },
    )
