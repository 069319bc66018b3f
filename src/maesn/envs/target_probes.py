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
    """The first action has to hit a target g on the upper half circle of radius 1.

    The observation is the elapsed share of the episode (1 component) and a_0 (2 components, zero
    before the first step). Later actions change nothing. All rewards are 0 but the last. The dense
    one is -|a_0 - g|^2. The sparse one is the same if |a_0 - g| is at most `sparse_radius`;
    otherwise it is -|g|^2, as for the action 0.

    If a_0 ~ N(m, diag(s^2)), the expected dense return is -(|m - g|^2 + sum_i s_i^2). The best
    single action for all targets is their mean (0, 2/pi), with return -(1 - 4/pi^2) = -0.595. An
    agent with a higher return has adapted to the task.
    """

    sparse_radius: eqx.AbstractVar[float]

    def initial(self, key: Key, task: Goal) -> tuple[Float[Array, " 3"], Float[Array, " 3"]]:
        return jnp.zeros(3), jnp.zeros(3)

    def control(self, action: Float[Array, " action"]) -> Float[Array, " 2"]:
        return action

    def advance(self, readings: Readings, control: Float[Array, " control"]) -> Readings:
        step, first_action = readings["qpos"][:1], readings["qpos"][1:]
        first_action = jnp.where(step == 0, control, first_action)
        return {"qpos": jnp.concatenate([step + 1, first_action]), "qvel": readings["qvel"]}

    def observe(self, readings: Readings) -> Float[Array, " 3"]:
        return readings["qpos"] / jnp.array([self.horizon, 1.0, 1.0])

    def reward(
        self,
        readings: Readings,
        action: Float[Array, " action"],
        next_readings: Readings,
        task: Goal,
    ) -> Reward:
        squared_error = jnp.sum((next_readings["qpos"][1:] - task) ** 2)
        no_hit = -jnp.sum(task**2)
        goal = goal_reward(squared_error, no_hit, self.reward_kind, self.sparse_radius**2)
        is_last_step = next_readings["qpos"][0] == self.horizon
        return Reward(jnp.where(is_last_step, goal, 0.0), jnp.zeros(()))

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

    Its discount is gamma^(T-1).
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
