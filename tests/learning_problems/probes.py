"""Probes: tiny environments whose best return is known, each for one mechanism of learning.

A learner that fails on one of them has an error, which a robot's noise would hide.

No observation before the end of an episode depends on the task. Two more, `bandit` and `chain`, are
examples of the library.
"""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from bernoulli_bandit import bandit
from chain import chain
from jax import Array

from maesn.axes import Key, Readings
from maesn.envs import AbstractPureEnv, Reward, RewardKind, TaskFamily, Variant
from maesn.envs.goals import draw_half_circle, goal_reward
from maesn.envs.reaching import AbstractReaching

TARGET_RADIUS = 1.0
LONGEST_LIFETIME = 12.0  # steps


class Probe(AbstractPureEnv[Array]):
    """What most probes share."""

    control_period: ClassVar[float] = 1.0

    variant: Variant = "reference"
    reward_kind: RewardKind = "dense"
    sparse_radius: float = 0.0
    horizon: int = 10
    observation_size: int = 1
    action_size: int = 1

    def control(self, action: Array) -> Array:
        return action

    def position(self, observation: Array) -> Array:
        return jnp.zeros(2)

    def goal(self, task: Array) -> Array:
        return jnp.append(task, 0.0)


class HiddenTarget(AbstractReaching, Probe):
    """The first action has to hit a target g on the upper half circle of radius 1.

    The observation is the elapsed share of the episode (1 component) and a_0 (2 components, zero
    before the first step). Later actions change nothing. All rewards are 0 but the last. The dense
    one is -|a_0 - g|^2. The sparse one is the same if |a_0 - g| is at most `sparse_radius`;
    otherwise it is -|g|^2, as for the action 0.

    If a_0 ~ N(m, diag(s^2)), the expected dense return is -(|m - g|^2 + sum_i s_i^2). The best
    single action for all targets is their mean (0, 2/pi), with return -(1 - 4/pi^2) = -0.595. An
    agent with a higher return has adapted to the task.
    """

    name: ClassVar[str] = "hidden_target"

    sparse_radius: float = 0.5  # the action 0 is twice as far away
    horizon: int = 1
    observation_size: int = 3
    action_size: int = 2

    def initial(self, key: Key, task: Array) -> tuple[Array, Array]:
        return jnp.zeros(3), jnp.zeros(3)

    def advance(self, readings: Readings, control: Array) -> Readings:
        step, first_action = readings["qpos"][:1], readings["qpos"][1:]
        first_action = jnp.where(step == 0, control, first_action)
        return {"qpos": jnp.concatenate([step + 1, first_action]), "qvel": readings["qvel"]}

    def observe(self, readings: Readings) -> Array:
        return readings["qpos"] / jnp.array([self.horizon, 1.0, 1.0])

    def reward(
        self, readings: Readings, action: Array, next_readings: Readings, task: Array
    ) -> Reward:
        squared_error = jnp.sum((next_readings["qpos"][1:] - task) ** 2)
        no_hit = -jnp.sum(task**2)
        goal = goal_reward(squared_error, no_hit, self.reward_kind, self.sparse_radius**2)
        is_last_step = next_readings["qpos"][0] == self.horizon
        return Reward(jnp.where(is_last_step, goal, 0.0), jnp.zeros(()))

    def position(self, observation: Array) -> Array:
        return observation[1:]


class DelayedTarget(HiddenTarget):
    """The same over ten steps: the reward comes nine steps after the action that earned it."""

    name: ClassVar[str] = "delayed_target"
    horizon: int = 10


class HiddenSide(Probe):
    """Two tasks, left (-1) and right (+1), for an agent that is blind.

    Action (1): its sign is the direction of the step, of length 1/T. The agent starts at 0 and
    sees nothing (one component, always 0). With x_t its position and g the task:

        dense:   r_t = g (x_{t+1} - x_t)                        the return is g x_T
        sparse:  r_t = 1 where |x_{t+1} - g| <= sparse_radius, else 0

    By default the sparse reward needs all T steps. A policy without a latent decides every step
    anew, to the right with probability p: its expected return is p^T in one task and (1 - p)^T in
    the other, so at best 2^-T in the worse of them. One that draws a side per episode has 1/2 in
    both.
    """

    name: ClassVar[str] = "hidden_side"

    sparse_radius: float = 0.05

    def initial(self, key: Key, task: Array) -> tuple[Array, Array]:
        return jnp.zeros(1), jnp.zeros(1)

    def control(self, action: Array) -> Array:
        return jnp.sign(action)

    def advance(self, readings: Readings, control: Array) -> Readings:
        # Whole steps are counted, so that their sum is exact.
        return {"qpos": readings["qpos"] + control, "qvel": readings["qvel"]}

    def observe(self, readings: Readings) -> Array:
        return jnp.zeros(1)

    def reward(
        self, readings: Readings, action: Array, next_readings: Readings, task: Array
    ) -> Reward:
        step = (next_readings["qpos"][0] - readings["qpos"][0]) / self.horizon
        reached = self.solved(next_readings, task).astype(step.dtype)
        goal = task * step if self.reward_kind == "dense" else reached
        return Reward(goal, jnp.zeros(()))

    def solved(self, readings: Readings, task: Array) -> Array:
        return jnp.abs(readings["qpos"][0] / self.horizon - task) <= self.sparse_radius


class HiddenEnd(Probe):
    """An episode that ends after ceil(L) steps, L being the task, whatever the agent does.

    Observation (1): elapsed share of the horizon. Reward: 1 for every step lived, so that the
    return is min(ceil(L), T); sparse, 1 for the step that ends the episode. Afterwards states,
    observations and rewards are NaN: where a mask is forgotten, NaN shows it.
    """

    name: ClassVar[str] = "hidden_end"

    def initial(self, key: Key, task: Array) -> tuple[Array, Array]:
        return jnp.stack([jnp.zeros(()), task]), jnp.zeros(2)

    def advance(self, readings: Readings, control: Array) -> Readings:
        lived, lifetime = readings["qpos"]
        lived = jnp.where(self.terminated(readings), jnp.nan, lived + 1)
        return {"qpos": jnp.stack([lived, lifetime]), "qvel": readings["qvel"]}

    def observe(self, readings: Readings) -> Array:
        return readings["qpos"][:1] / self.horizon

    def reward(
        self, readings: Readings, action: Array, next_readings: Readings, task: Array
    ) -> Reward:
        lived = next_readings["qpos"][0] - readings["qpos"][0]
        sparse = jnp.where(self.solved(next_readings, task), lived, 0.0 * lived)
        return Reward(lived if self.reward_kind == "dense" else sparse, jnp.zeros(()))

    def terminated(self, readings: Readings) -> Array:
        lived, lifetime = readings["qpos"]
        return jnp.logical_not(lived < lifetime)  # true of NaN as well

    def solved(self, readings: Readings, task: Array) -> Array:
        return task - readings["qpos"][0] <= self.sparse_radius

    def position(self, observation: Array) -> Array:
        return jnp.append(observation, 0.0)


def _draw_targets(stream: np.random.Generator, size: int) -> np.ndarray:
    return draw_half_circle(stream, size, TARGET_RADIUS)


def _draw_sides(stream: np.random.Generator, size: int) -> np.ndarray:
    """Draw as many tasks on the left as on the right (one more on the left if `size` is odd)."""
    sides = np.where(np.arange(size) % 2 == 0, -1.0, 1.0)
    return stream.permutation(sides).astype(np.float32)


def _draw_lifetimes(stream: np.random.Generator, size: int) -> np.ndarray:
    """Draw lifetimes, one in six longer than the horizon: those episodes end by the clock."""
    return stream.uniform(0.0, LONGEST_LIFETIME, size).astype(np.float32)


hidden_target = TaskFamily("hidden_target", HiddenTarget, _draw_targets, ("target",), seed=31)
delayed_target = TaskFamily("delayed_target", DelayedTarget, _draw_targets, ("target",), seed=32)
hidden_side = TaskFamily("hidden_side", HiddenSide, _draw_sides, ("side",), seed=33)
hidden_end = TaskFamily("hidden_end", HiddenEnd, _draw_lifetimes, ("lifetime",), seed=34)

PROBES: dict[str, TaskFamily] = {
    family.name: family
    for family in (hidden_target, delayed_target, hidden_side, hidden_end, bandit, chain)
}
