"""What the families on Gymnasium's robots share: starts, controls, and one reward.

`maesn.envs.cheetah` and `maesn.envs.ant_v5` have the families. Their robots are those of
Gymnasium's `HalfCheetah-v5` and `Ant-v5`, read from the installed package (`pip install -e
'.[gym]'`) and moved by the native engine, in double precision step for step as there.
"""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.axes import Action, Key, Readings
from maesn.envs.base import AbstractMujocoEnv, Reward, Task

NOISE = 0.1  # of the start: half width of positions, standard deviation of velocities; v5
HORIZON = 200  # steps, in all of the sources


class AbstractWalking(AbstractMujocoEnv[Task]):
    """A robot of Gymnasium's with the one reward of its task, dense and sparse alike."""

    frame_skip: ClassVar[int] = 5
    control_period: ClassVar[float] = 0.05
    variants: ClassVar[tuple[str, ...]] = ("reference",)
    has_one_reward: ClassVar[bool] = True
    standing: eqx.AbstractClassVar[tuple[float, ...]]
    """qpos that starts scatter around: the model's own."""
    num_speeds: eqx.AbstractClassVar[int]
    """Components of qvel."""
    control_cost: eqx.AbstractClassVar[float]
    """Cost of a squared unit of control."""

    def initial(self, key: Key, task: Task) -> tuple[Float[Array, " qpos"], Float[Array, " qvel"]]:
        position_key, velocity_key = jax.random.split(key)
        standing = jnp.asarray(self.standing)
        moved = jax.random.uniform(position_key, standing.shape, minval=-NOISE, maxval=NOISE)
        return standing + moved, NOISE * jax.random.normal(velocity_key, (self.num_speeds,))

    def control(self, action: Action) -> Float[Array, " control"]:
        return jnp.clip(action, -1.0, 1.0)

    @abstractmethod
    def goal_reward(
        self, readings: Readings, next_readings: Readings, task: Task
    ) -> Float[Array, ""]:
        """Return the part of a step's reward that depends on the task."""

    def reward(
        self, readings: Readings, action: Action, next_readings: Readings, task: Task
    ) -> Reward:
        goal = self.goal_reward(readings, next_readings, task)
        return Reward(goal, -self.costs(next_readings, action))

    def costs(self, readings: Readings, action: Action) -> Float[Array, ""]:
        """Return the cost of the control, and of the state that it led to."""
        return self.control_cost * jnp.sum(self.control(action) ** 2)

    def velocity(self, readings: Readings, next_readings: Readings) -> Float[Array, " 2"]:
        """Return the mean velocity in a step, m/s: along x and y, or x and z of a cheetah."""
        return (next_readings["qpos"][:2] - readings["qpos"][:2]) / self.control_period

    def situation(self, task: Task) -> Any:
        """Return nothing: the task decides the reward alone."""
        return ()


class AbstractPlaceless(AbstractWalking[Task]):
    """A task without a goal that one could reach or draw."""

    planar: ClassVar[bool] = False
    defines_success: ClassVar[bool] = False

    def solved(self, readings: Readings, task: Task) -> Bool[Array, ""]:
        """Never: the sources define no success."""
        return jnp.zeros((), bool)

    def position(self, observation: Float[Array, " observation"]) -> Float[Array, " 2"]:
        return jnp.full(2, jnp.nan)

    def goal(self, task: Task) -> Float[Array, " 2"]:
        return jnp.full(2, jnp.nan)
