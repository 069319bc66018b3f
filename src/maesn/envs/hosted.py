"""Environments that others wrote, with Gymnasium's interface, hosted in processes of their own.

Observations are flattened. Actions are mapped once, for all tasks: the policy's action a is
unbounded, and component i of the control is

    u_i = clip(middle_i + half_i a_i, lower_i, upper_i),

with the middle and half the width of the action space: a = 0 is the middle, and +-1 are the bounds.
A `Discrete` action space becomes a choice, a one-hot vector.

The reward is the environment's own, as is the end of an episode: `terminated` is the task's, and
`truncated` is a clock's. Success is `info["is_success"]` or else `info["success"]`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt32

from maesn.axes import Action, Key, Readings
from maesn.envs.base import AbstractEnv, Reward, RewardKind, Variant
from maesn.foreign import Interface, WorkerPool


def nowhere(_: Any) -> Float[Array, " 2"]:
    """Return no position: figures that need one are left out."""
    return jnp.full(2, jnp.nan)


@dataclass(frozen=True)
class Recipe:
    """How the environments of a family are made, hosted and shown; see `gymnasium_family`."""

    make_env: Callable[[Any, str], Any] | str
    time_limit: float
    max_environments: int
    position: Callable[[Any], Any]
    goal: Callable[[Any], Any]
    situation: Callable[[Any], Any] | None
    reward: Callable[..., Any] | None
    python: str = ""


class AbstractGymnasiumEnv(AbstractEnv[Any]):
    """Somebody else's environment, which runs in processes of its own.

    Each family is a class, made by `gymnasium_family`.
    """

    engine: ClassVar[str] = "gymnasium"
    # Far from the goal it may depend on the task.
    has_one_reward: ClassVar[bool] = True
    interface: eqx.AbstractClassVar[Interface]
    recipe: eqx.AbstractClassVar[Recipe]

    horizon: int
    observation_size: int
    action_size: int
    reward_kind: RewardKind
    sparse_radius: float = 0.0
    """Not known here: 0."""
    variant: Variant = "reference"

    def start(self, key: Key, task: Any) -> UInt32[Array, ""]:
        """Return the seed that the episode is reset with."""
        return jax.random.bits(key, dtype=jnp.uint32)

    def control(self, action: Action) -> Float[Array, " control"]:
        if self.action_kind == "discrete":
            return action
        lower, upper = np.array([self.interface.lower, self.interface.upper], np.float32)
        return jnp.clip((lower + upper) / 2 + (upper - lower) / 2 * action, lower, upper)

    def observe(self, readings: Readings) -> Float[Array, " observed"]:
        return readings["observation"]

    def reward(
        self, readings: Readings, action: Action, next_readings: Readings, task: Any
    ) -> Reward:
        """Return the environment's reward, all of it as the goal's part."""
        if self.recipe.reward is None:
            return Reward(goal=next_readings["reward"], other=jnp.zeros(()))
        seen = readings["observation"], self.control(action), next_readings["observation"]
        return Reward(goal=self.recipe.reward(*seen, task, self.reward_kind), other=jnp.zeros(()))

    def observation_names(self) -> tuple[str, ...]:
        """Return the parts of the space, in order."""
        return tuple(self.interface.spaces["observation"][1])

    def situation(self, task: Any) -> Any:
        """Return what of a task an episode depends on, as the family says."""
        return task if self.recipe.situation is None else self.recipe.situation(task)

    def open_pool(self, num_workers: int) -> WorkerPool:
        """Return workers that host this environment; nothing is started yet."""
        how, kind = self.recipe, self.reward_kind
        return WorkerPool(
            how.make_env, kind, self.interface.spaces, num_workers, how.time_limit, how.python
        )

    def terminated(self, readings: Readings) -> Bool[Array, ""]:
        return readings["terminated"] > 0

    def truncated(self, readings: Readings) -> Bool[Array, ""]:
        return readings["truncated"] > 0

    def solved(self, readings: Readings, task: Any) -> Bool[Array, ""]:
        return readings["solved"] > 0

    def position(self, observation: Float[Array, " observation"]) -> Float[Array, " 2"]:
        return self.recipe.position(observation)

    def goal(self, task: Any) -> Float[Array, " 2"]:
        return self.recipe.goal(task)


def task_row(tasks: Any, row: int) -> Any:
    """Return one of several tasks as `make_env` and `set_task` get it."""
    return as_given(jax.tree.map(lambda x: x[row], tasks))


def as_given(task: Any) -> Any:
    """Return a task as `make_env` and `set_task` get it: NumPy arrays of single precision."""
    return jax.tree.map(lambda x: np.asarray(jnp.asarray(x)), task)
