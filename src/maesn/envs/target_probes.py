"""Probes of the policy gradient and of credit assignment: the action must hit a hidden target.

See `maesn.envs.probes` for what probes are.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maesn.axes import Key, Readings
from maesn.envs.base import Reward, RewardKind, Variant
from maesn.envs.goals import draw_half_circle, goal_reward
from maesn.envs.probes import AbstractProbe
from maesn.envs.reaching import AbstractReaching, Goal
from maesn.envs.tasks import TaskFamily

TARGET_RADIUS = 1.0
SPARSE_RADIUS = 0.5  # the action 0 is twice as far away


class AbstractTargetProbe(AbstractReaching, AbstractProbe[Goal]):
    """A target g on the upper half circle of radius 1, which the first action has to hit.

    State and observation: share of the episode that is over (1), then a_0 (2; zero before it is
    known). Later actions change nothing. The reward comes at step T-1 alone: -|a_0 - g|^2; sparse,
    the same within the radius, and elsewhere -|g|^2, the reward of the action 0.

    If a_0 ~ N(m, diag(s^2)), the expected dense return is -(|m - g|^2 + sum_i s_i^2). The best
    action for all targets together is their mean (0, 2/pi), with return -(1 - 4/pi^2) = -0.595. An
    agent with a higher return has learned from the task.
    """

    sparse_radius: eqx.AbstractVar[float]

    def initial(self, key: Key, task: Goal) -> tuple[Float[Array, " 3"], Float[Array, " 3"]]:
        return jnp.zeros(3), jnp.zeros(3)

    def control(self, action: Float[Array, " action"]) -> Float[Array, " 2"]:
        return action

    def advance(self, readings: Readings, control: Float[Array, " control"]) -> Readings:
        steps, first = readings["qpos"][:1], readings["qpos"][1:]
        first = jnp.where(steps == 0, control, first)
        return {"qpos": jnp.concatenate([steps + 1, first]), "qvel": readings["qvel"]}

    def observe(self, readings: Readings) -> Float[Array, " 3"]:
        return readings["qpos"] / jnp.array([self.horizon, 1.0, 1.0])

    def reward(
        self,
        readings: Readings,
        action: Float[Array, " action"],
        next_readings: Readings,
        task: Goal,
    ) -> Reward:
        error = jnp.sum((next_readings["qpos"][1:] - task) ** 2)
        goal = goal_reward(error, -jnp.sum(task**2), self.reward_kind, self.sparse_radius**2)
        last = next_readings["qpos"][0] == self.horizon
        return Reward(jnp.where(last, goal, 0.0), jnp.zeros(()))

    def position(self, observation: Float[Array, " observation"]) -> Float[Array, " 2"]:
        return observation[1:]


class HiddenTarget(AbstractTargetProbe):
    """A bandit: the target probe in one step."""

    name: ClassVar[str] = "hidden_target"

    variant: Variant = "reference"
    reward_kind: RewardKind = "dense"
    sparse_radius: float = SPARSE_RADIUS
    horizon: int = 1
    observation_size: int = 3
    action_size: int = 2


class DelayedTarget(AbstractTargetProbe):
    """The target probe over ten steps: the reward comes nine steps after the action that earned it.

    Discounted to the start it is gamma^(T-1) times as much.
    """

    name: ClassVar[str] = "delayed_target"

    variant: Variant = "reference"
    reward_kind: RewardKind = "dense"
    sparse_radius: float = SPARSE_RADIUS
    horizon: int = 10
    observation_size: int = 3
    action_size: int = 2


def _draw_targets(stream: np.random.Generator, size: int) -> np.ndarray:
    return draw_half_circle(stream, size, TARGET_RADIUS)


hidden_target = TaskFamily("hidden_target", HiddenTarget, _draw_targets, ("target",), seed=31)
delayed_target = TaskFamily("delayed_target", DelayedTarget, _draw_targets, ("target",), seed=32)
