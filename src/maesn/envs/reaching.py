"""Environments whose task is a position: the agent has to get there, and does not see where."""

from typing import ClassVar, TypeAlias

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.axes import Action, Key, Readings
from maesn.envs.base import AbstractEnv, AbstractPureEnv, Reward
from maesn.envs.goals import goal_reward

Goal: TypeAlias = Float[Array, " 2"]
# Metres from the start; every goal of the reference's task files lies on this circle.
GOAL_RADIUS = 2.0


class AbstractReaching(AbstractEnv[Goal]):
    """The task is a goal g, and it is solved where the agent is near enough to g."""

    def distance(self, readings: Readings, task: Goal) -> Float[Array, ""]:
        """Return d, the distance from the goal."""
        return jnp.linalg.norm(self.judged_position(readings, task) - task)

    def solved(self, readings: Readings, task: Goal) -> Bool[Array, ""]:
        return self.distance(readings, task) <= self.sparse_radius

    def goal(self, task: Goal) -> Goal:
        return task

    def situation(self, task: Goal) -> tuple[()]:
        """Return nothing: the goal decides the reward alone."""
        return ()


class AbstractPoint(AbstractReaching, AbstractPureEnv[Goal]):
    """A point that starts at the origin and sees where it is, and nothing else."""

    def initial(self, key: Key, task: Goal) -> tuple[Float[Array, " 2"], Float[Array, " 2"]]:
        return jnp.zeros(2), jnp.zeros(2)

    def observe(self, readings: Readings) -> Float[Array, " 2"]:
        return readings["qpos"]

    def position(self, observation: Float[Array, " observation"]) -> Float[Array, " 2"]:
        return observation[:2]


class AbstractDriving(AbstractReaching):
    """A robot that drives from the origin to a goal, and sees first of all where it is."""

    c_max: ClassVar[float] = GOAL_RADIUS
    """The paper's "uninformative large negative constant", sign turned: the distance at the start,
    and so minus the dense reward there."""
    control_cost: ClassVar[float] = 0.05
    """Cost of a squared unit of control; reference, where it is a squared newton metre."""

    def reward(
        self, readings: Readings, action: Action, next_readings: Readings, task: Goal
    ) -> Reward:
        """Return the reward of one step.

        With d the distance to the goal g after the step, u the control and 1[.] an indicator:

            reference:  r = -d 1[near] - |g|_2 1[far] - control_cost * sum_i u_i^2
            paper:      r = -d 1[near] - c_max 1[far]

        Dense, every distance is near; sparse, d > sparse_radius is far. The paper's form is that
        of its appendix "Reward Functions". The reference adds a control cost, and its constant far
        from the goal is the dense reward at the start, which differs from task to task.
        """
        distance = self.distance(next_readings, task)
        far = self.far_reward(task)
        goal = goal_reward(distance, far, self.reward_kind, self.sparse_radius)
        if self.variant == "paper":
            return Reward(goal, jnp.zeros(()))
        return Reward(goal, -self.control_cost * jnp.sum(self.control(action) ** 2))

    def far_reward(self, task: Goal) -> Float[Array, ""]:
        if self.variant == "paper":
            return jnp.asarray(-self.c_max)
        return -jnp.linalg.norm(task)

    @property
    def uninformative_reward(self) -> float:
        return -self.c_max

    def position(self, observation: Float[Array, " observation"]) -> Float[Array, " 2"]:
        return observation[:2]
