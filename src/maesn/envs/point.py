"""A point that slides on a plane towards a hidden goal: the fast family.

It has the wheeled robot's goals and rewards but no dynamics, so MAESN trains on it in seconds. It
is not in the paper; its variants follow those of `maesn.envs.wheeled`.

Observation (2 components; the goal is not among them): position x, y in metres.

Action (2 components a, unbounded): velocity in x and y, u = clip(a, -1, 1) m/s.

The reward is that of `AbstractDriving`. Episodes last 40 steps of 0.1 s and never terminate.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import Action, Key, Readings
from maesn.envs.base import RewardKind, Variant
from maesn.envs.goals import half_circle_family
from maesn.envs.reaching import GOAL_RADIUS, AbstractDriving, AbstractPoint, Goal

# Metres; a quarter of the way, so that a jittering point hardly ever gets there.
SPARSE_RADIUS = 0.5
STEP_LENGTH = 0.1  # metres per unit of action: the goal is 20 full steps away
POSITION_NOISE = 0.01  # standard deviation of the start in metres


class Point(AbstractDriving, AbstractPoint):
    """A point that slides to a hidden goal on a half circle: trains in seconds."""

    name: ClassVar[str] = "point"
    control_period: ClassVar[float] = 0.1

    variant: Variant = "reference"
    reward_kind: RewardKind = "dense"
    sparse_radius: float = SPARSE_RADIUS
    horizon: int = 40
    observation_size: int = 2
    action_size: int = 2

    def initial(self, key: Key, task: Goal) -> tuple[Float[Array, " 2"], Float[Array, " 2"]]:
        return POSITION_NOISE * jax.random.normal(key, (2,)), jnp.zeros(2)

    def control(self, action: Action) -> Float[Array, " 2"]:
        return jnp.clip(action, -1.0, 1.0)

    def advance(self, readings: Readings, control: Float[Array, " control"]) -> Readings:
        velocity = STEP_LENGTH / self.control_period * control
        return {"qpos": readings["qpos"] + self.control_period * velocity, "qvel": velocity}


point = half_circle_family("point", Point, GOAL_RADIUS, seed=2)
