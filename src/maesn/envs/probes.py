"""Probes: tiny environments whose best return is known, each for one mechanism of learning.

They are not in the paper, and both variants are the same. A learner that fails on one of them has
an error, which a robot's noise would hide.

| family           | mechanism                                   | best return, dense; sparse      |
|------------------|---------------------------------------------|---------------------------------|
| `hidden_target`  | policy gradient: one step, one action       | 0; 0                            |
| `delayed_target` | credit: only a_0 counts, rewarded last      | 0; 0                            |
| `hidden_side`    | coherent choice: the same side T times      | 1; 1                            |
| `hidden_end`     | masks: nature ends the episode, NaN follows | steps lived; 1                  |
| `chain`          | exploration: only the far end is rewarded   | 30/g; 51 - g, in whole steps    |
| `bandit`         | recurrence: find the best arm, then pull it | 6.66 of 10 on average, the same |

One control step counts as one second, positions have no unit, velocities are not used (zero), and
nothing is random but the policy and the rewards of `bandit`. No observation before the end of an
episode depends on the task.
"""

from typing import ClassVar, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from maesn.axes import Key, Readings
from maesn.envs.base import AbstractPureEnv, Reward, RewardKind, Task, Variant
from maesn.envs.goals import within
from maesn.envs.tasks import TaskFamily

Side: TypeAlias = Float[Array, ""]
Lifetime: TypeAlias = Float[Array, ""]

LONGEST_LIFETIME = 12.0  # steps


class AbstractProbe(AbstractPureEnv[Task]):
    """What all probes share: one control step counts as one second."""

    control_period: ClassVar[float] = 1.0


class HiddenSide(AbstractProbe[Side]):
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

    variant: Variant = "reference"
    reward_kind: RewardKind = "dense"
    sparse_radius: float = 0.05
    horizon: int = 10
    observation_size: int = 1
    action_size: int = 1

    def initial(self, key: Key, task: Side) -> tuple[Float[Array, " 1"], Float[Array, " 1"]]:
        return jnp.zeros(1), jnp.zeros(1)

    def control(self, action: Float[Array, " action"]) -> Float[Array, " 1"]:
        return jnp.sign(action)

    def advance(self, readings: Readings, control: Float[Array, " control"]) -> Readings:
        # Whole steps are counted, so that their sum is exact.
        return {"qpos": readings["qpos"] + control, "qvel": readings["qvel"]}

    def observe(self, readings: Readings) -> Float[Array, " 1"]:
        return jnp.zeros(1)

    def reward(
        self,
        readings: Readings,
        action: Float[Array, " action"],
        next_readings: Readings,
        task: Side,
    ) -> Reward:
        step = (next_readings["qpos"][0] - readings["qpos"][0]) / self.horizon
        reached = self.solved(next_readings, task).astype(step.dtype)
        goal = task * step if self.reward_kind == "dense" else reached
        return Reward(goal, jnp.zeros(()))

    def solved(self, readings: Readings, task: Side) -> Bool[Array, ""]:
        return within(jnp.abs(readings["qpos"][0] / self.horizon - task), self.sparse_radius)

    def position(self, observation: Float[Array, " observation"]) -> Float[Array, " 2"]:
        """Return the start: what the agent sees does not say where it is."""
        return jnp.zeros(2)

    def goal(self, task: Side) -> Float[Array, " 2"]:
        return jnp.stack([task, jnp.zeros(())])


class HiddenEnd(AbstractProbe[Lifetime]):
    """An episode that ends after ceil(L) steps, L being the task, whatever the agent does.

    Observation (1): elapsed share of the horizon. Reward: 1 for every step lived, so that the
    return is min(ceil(L), T); sparse, 1 for the step that ends the episode. Afterwards states,
    observations and rewards are NaN: where a mask is forgotten, NaN shows it.
    """

    name: ClassVar[str] = "hidden_end"

    variant: Variant = "reference"
    reward_kind: RewardKind = "dense"
    sparse_radius: float = 0.0
    """Sparse, steps are rewarded from this many steps before the end."""
    horizon: int = 10
    observation_size: int = 1
    action_size: int = 1

    def initial(self, key: Key, task: Lifetime) -> tuple[Float[Array, " 2"], Float[Array, " 2"]]:
        return jnp.stack([jnp.zeros(()), task]), jnp.zeros(2)

    def control(self, action: Float[Array, " action"]) -> Float[Array, " action"]:
        return action

    def advance(self, readings: Readings, control: Float[Array, " control"]) -> Readings:
        lived, lifetime = readings["qpos"]
        lived = jnp.where(self.terminated(readings), jnp.nan, lived + 1)
        return {"qpos": jnp.stack([lived, lifetime]), "qvel": readings["qvel"]}

    def observe(self, readings: Readings) -> Float[Array, " 1"]:
        return readings["qpos"][:1] / self.horizon

    def reward(
        self,
        readings: Readings,
        action: Float[Array, " action"],
        next_readings: Readings,
        task: Lifetime,
    ) -> Reward:
        lived = next_readings["qpos"][0] - readings["qpos"][0]
        sparse = jnp.where(self.solved(next_readings, task), lived, 0.0 * lived)
        return Reward(lived if self.reward_kind == "dense" else sparse, jnp.zeros(()))

    def terminated(self, readings: Readings) -> Bool[Array, ""]:
        lived, lifetime = readings["qpos"]
        return jnp.logical_not(lived < lifetime)  # true of NaN as well

    def solved(self, readings: Readings, task: Lifetime) -> Bool[Array, ""]:
        return within(task - readings["qpos"][0], self.sparse_radius)

    def position(self, observation: Float[Array, " observation"]) -> Float[Array, " 2"]:
        return jnp.append(observation, 0.0)

    def goal(self, task: Lifetime) -> Float[Array, " 2"]:
        return jnp.stack([task / self.horizon, jnp.zeros(())])


def _draw_sides(stream: np.random.Generator, size: int) -> np.ndarray:
    """Draw as many tasks on the left as on the right (one more on the left if `size` is odd)."""
    sides = np.where(np.arange(size) % 2 == 0, -1.0, 1.0)
    return stream.permutation(sides).astype(np.float32)


def _draw_lifetimes(stream: np.random.Generator, size: int) -> np.ndarray:
    """Draw lifetimes, one in six longer than the horizon: those episodes end by the clock."""
    return stream.uniform(0.0, LONGEST_LIFETIME, size).astype(np.float32)


hidden_side = TaskFamily("hidden_side", HiddenSide, _draw_sides, ("side",), seed=33)
hidden_end = TaskFamily("hidden_end", HiddenEnd, _draw_lifetimes, ("lifetime",), seed=34)
