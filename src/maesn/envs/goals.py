"""Goal-reaching rewards of the paper's appendix "Reward Functions"."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from maesn.envs.base import Reward, RewardKind, Variant

Vector = Float[Array, " 2"]

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


def driving_reward(
    distance: Float[Array, ""],
    goal: Vector,
    control: Float[Array, " control"],
    *,
    variant: Variant,
    reward_kind: RewardKind,
    sparse_radius: float,
    c_max: float,
    control_cost: float,
) -> Reward:
    """Return the reward of a robot that starts at the origin and drives to a goal.

    With d the distance to the goal g after the step, u the control and 1[.] an indicator:

        reference:  r = -d 1[near] - |g|_2 1[far] - control_cost * sum_i u_i^2
        paper:      r = -d 1[near] - c_max 1[far]

    Dense, every distance is near; sparse, d > sparse_radius is far. The paper's form is that of
    its appendix "Reward Functions"; the reference adds a control cost, and pays far from the goal
    what the dense reward pays at the start, so that its constant differs from task to task.

    Args:
        distance: d in metres.
        goal: g in metres.
        control: u, what reaches the actuators.
        variant: whose formula.
        reward_kind: dense or sparse.
        sparse_radius: radius of the goal region in metres.
        c_max: the paper's "uninformative large negative constant", sign turned.
        control_cost: price of a squared unit of control.
    """
    if variant == "paper":
        goal_part = goal_reward(distance, -c_max, reward_kind, sparse_radius)
        return Reward(goal_part, jnp.zeros(()))
    goal_part = goal_reward(distance, -jnp.linalg.norm(goal), reward_kind, sparse_radius)
    return Reward(goal_part, -control_cost * jnp.sum(control**2))


def within(distance: Float[Array, ""], radius: float) -> Bool[Array, ""]:
    """Whether the goal region is reached."""
    return distance <= radius


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
