"""A two-wheeled robot that drives to a goal it is not told (section "Wheeled Locomotion").

Observation (12 components; the goal is not among them):

| index | quantity                             | unit  |
|-------|--------------------------------------|-------|
| 0-2   | position x, y, z of the car          | m     |
| 3     | heading (yaw)                        | rad   |
| 4-5   | angle of the right and left wheel    | rad   |
| 6-8   | velocity x, y, z of the car          | m/s   |
| 9     | rate of turn                         | rad/s |
| 10-11 | speed of the right and left wheel    | rad/s |

Action (2 components, unbounded): torque demand of the right and left wheel. The motors receive
u = clip(2 a, -2, 2) N m.

Reward, with d the distance of the car from the goal g in metres:

| variant     | dense               | sparse, outside of the radius |
|-------------|---------------------|-------------------------------|
| `reference` | -d - 0.05 sum(u^2)  | -|g| - 0.05 sum(u^2)          |
| `paper`     | -d                  | -c_max                        |

Episodes last 200 steps of 0.01 s and never terminate.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from maesn.axes import Key, Readings
from maesn.envs.base import AbstractMujocoEnv, Reward, RewardKind, Variant
from maesn.envs.goals import (
    draw_half_circle,
    draw_unfamiliar_goals,
    driving_reward,
    within,
)
from maesn.envs.tasks import TaskFamily

Goal = Float[Array, " 2"]

GOAL_RADIUS = 2.0  # metres; every goal of the reference's task files lies on this circle
SPARSE_RADIUS = 0.8  # metres; appendix "Reward Functions"
# The paper calls it "an uninformative large negative constant". All goals lie 2 m from the start,
# so this is what the dense reward pays a robot that has not moved.
C_MAX = 2.0
CONTROL_COST = 0.05  # reference, per squared newton metre
ACTION_SCALE = 2.0  # the motors' range, +-2 N m
POSITION_NOISE = 0.01  # standard deviation of the start, reference
VELOCITY_NOISE = 0.1


class Wheeled(AbstractMujocoEnv[Goal]):
    """A two-wheeled robot that drives to a goal on a half circle, which it is not told."""

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

    def control(self, action: Float[Array, " action"]) -> Float[Array, " 2"]:
        return jnp.clip(ACTION_SCALE * action, -ACTION_SCALE, ACTION_SCALE)

    def observe(self, readings: Readings) -> Float[Array, " 12"]:
        return jnp.concatenate([readings["qpos"], readings["qvel"]])

    def instruction(self, task: Goal) -> Float[Array, " 0"]:
        return jnp.zeros(0)

    def reward(
        self,
        readings: Readings,
        action: Float[Array, " action"],
        next_readings: Readings,
        task: Goal,
    ) -> Reward:
        return driving_reward(
            _distance(next_readings, task),
            task,
            self.control(action),
            variant=self.variant,
            reward_kind=self.reward_kind,
            sparse_radius=self.sparse_radius,
            c_max=C_MAX,
            control_cost=CONTROL_COST,
        )

    @property
    def uninformative_reward(self) -> float:
        return -C_MAX

    def terminated(self, readings: Readings) -> Bool[Array, ""]:
        return jnp.zeros((), bool)

    def solved(self, readings: Readings, task: Goal) -> Bool[Array, ""]:
        return within(_distance(readings, task), self.sparse_radius)

    def position(self, observation: Float[Array, " observation"]) -> Float[Array, " 2"]:
        return observation[:2]

    def goal(self, task: Goal) -> Float[Array, " 2"]:
        return task

    def model_fields(self, task: Goal) -> dict[str, Array]:
        return {}


def _distance(readings: Readings, goal: Goal) -> Float[Array, ""]:
    return jnp.linalg.norm(readings["qpos"][:2] - goal)


def _draw_goals(stream: np.random.Generator, size: int) -> np.ndarray:
    return draw_half_circle(stream, size, GOAL_RADIUS)


def _draw_unfamiliar_goals(stream: np.random.Generator, size: int) -> np.ndarray:
    return draw_unfamiliar_goals(stream, size, GOAL_RADIUS)


wheeled = TaskFamily(
    "wheeled", Wheeled, _draw_goals, ("goal",), seed=2018, draw_ood_tasks=_draw_unfamiliar_goals
)
