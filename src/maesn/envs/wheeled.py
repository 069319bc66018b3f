"""A two-wheeled robot that drives to a hidden goal (section "Wheeled Locomotion").

Observation (12 components; the goal is not among them):

| index | quantity                             | unit  |
|-------|--------------------------------------|-------|
| 0-2   | position x, y, z of the car          | m     |
| 3     | heading (yaw)                        | rad   |
| 4-5   | angle of the right and left wheel    | rad   |
| 6-8   | velocity x, y, z of the car          | m/s   |
| 9     | rate of turn                         | rad/s |
| 10-11 | speed of the right and left wheel    | rad/s |

Action (2 components a, unbounded; the motors receive u = clip(2 a, -2, 2) N m): torque on the right
and on the left wheel.

The reward is that of `AbstractDriving`. Episodes last 200 steps of 0.01 s and never terminate.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import Action, Key, Readings
from maesn.envs.base import AbstractMujocoEnv, RewardKind, Variant
from maesn.envs.goals import half_circle_family
from maesn.envs.reaching import GOAL_RADIUS, AbstractDriving, Goal

SPARSE_RADIUS = 0.8  # metres; appendix "Reward Functions"
ACTION_SCALE = 2.0  # the motors' range, +-2 N m
POSITION_NOISE = 0.01  # standard deviation of the start, reference
VELOCITY_NOISE = 0.1


class Wheeled(AbstractDriving, AbstractMujocoEnv[Goal]):
    """A two-wheeled robot that drives to a hidden goal on a half circle."""

    name: ClassVar[str] = "wheeled"
    model: ClassVar[str] = "wheeled.xml"
    readings: ClassVar[tuple[str, ...]] = ("qpos", "qvel")
    control_period: ClassVar[float] = 0.01

    variant: Variant = "reference"
    reward_kind: RewardKind = "dense"
    sparse_radius: float = SPARSE_RADIUS
    horizon: int = 200
    observation_size: int = 12
    action_size: int = 2

    def initial(self, key: Key, task: Goal) -> tuple[Float[Array, " 6"], Float[Array, " 6"]]:
        position_key, velocity_key = jax.random.split(key)
        qpos = POSITION_NOISE * jax.random.normal(position_key, (6,))
        return qpos, VELOCITY_NOISE * jax.random.normal(velocity_key, (6,))

    def control(self, action: Action) -> Float[Array, " 2"]:
        return jnp.clip(ACTION_SCALE * action, -ACTION_SCALE, ACTION_SCALE)

    def observe(self, readings: Readings) -> Float[Array, " 12"]:
        return jnp.concatenate([readings["qpos"], readings["qvel"]])


wheeled = half_circle_family("wheeled", Wheeled, GOAL_RADIUS, seed=2018)
