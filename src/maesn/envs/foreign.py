"""Families of environments that others wrote, with Gymnasium's interface.

Observations are flattened. Actions are mapped once, for all tasks: the policy's action a is
unbounded, and component i of the control is

    u_i = clip(middle_i + half_i a_i, lower_i, upper_i),

with the middle and half the width of the action space: a = 0 is the middle, and +-1 are the bounds.
A `Discrete` action space becomes a choice, a one-hot vector.

The bounds are the tightest of the environment and its wrappers. The reward is the environment's
own, as is the end of an episode: `terminated` is the task's, and `truncated` is a clock's. Success
is `info["is_success"]` or else `info["success"]`.
"""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt32

from maesn.axes import ActionKind, Key, ObservedReward, Readings
from maesn.envs.base import AbstractEnv, Reward, RewardKind, Variant
from maesn.envs.tasks import TaskFamily
from maesn.foreign import Interface, InterfaceError, WorkerError, WorkerPool, pack_task

# Seconds. Making an environment can take long on a machine that does much else.
TIME_LIMIT = 120.0
# Hosted environments take memory: about 20 MB each where a model has meshes.
MAX_ENVIRONMENTS = 500


def nowhere(_: Any) -> Float[Array, " 2"]:
    """Return no position: figures that need one are left out."""
    return jnp.full(2, jnp.nan)


@dataclass(frozen=True)
class Recipe:
    """How the environments of a family are made, hosted and shown."""

    make_env: Callable[[Any, str], Any] | str
    """Called with a task and "dense" or "sparse"; or its `module:name`."""
    time_limit: float
    """Seconds that one call of an environment may take."""
    max_environments: int
    """Environments that adaptation may keep at once."""
    position: Callable[[Any], Any]
    """Planar position (metres) for figures from an observation, or `nowhere`."""
    goal: Callable[[Any], Any]
    """Planar position (metres) for figures from a task, or `nowhere`."""
    situation: Callable[[Any], Any] | None
    """What of a task an episode depends on; None for all of it."""
    reward: Callable[..., Any] | None
    """The environment's own reward, as a function; None if it cannot be said."""


class AbstractGymnasiumEnv(AbstractEnv[Any]):
    """Somebody else's environment, which runs in processes of its own.

    Each family is a class, made by `gymnasium_family`.
    """

    engine: ClassVar[str] = "gymnasium"

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

    def control(self, action: Float[Array, " action"]) -> Float[Array, " control"]:
        if self.action_kind == "discrete":
            return action
        lower, upper = (
            jnp.asarray(bounds, jnp.float32)
            for bounds in (self.interface.lower, self.interface.upper)
        )
        return jnp.clip((lower + upper) / 2 + (upper - lower) / 2 * action, lower, upper)

    def observe(self, readings: Readings) -> Float[Array, " observed"]:
        return readings["observation"]

    def reward(
        self,
        readings: Readings,
        action: Float[Array, " action"],
        next_readings: Readings,
        task: Any,
    ) -> Reward:
        """Return the environment's reward, all of it as the goal's part."""
        if self.recipe.reward is None:
            return Reward(goal=next_readings["reward"], other=jnp.zeros(()))
        seen = readings["observation"], self.control(action), next_readings["observation"]
        return Reward(goal=self.recipe.reward(*seen, task, self.reward_kind), other=jnp.zeros(()))

    def observed_reward(
        self,
        kind: ObservedReward,
        readings: Readings,
        action: Float[Array, " action"],
        next_readings: Readings,
        task: Any,
    ) -> Float[Array, ""]:
        """Return the environment's reward as it is: far from the goal it may depend on the task."""
        return self.reward(readings, action, next_readings, task).total

    def observation_names(self) -> tuple[str, ...]:
        """Return names of the components of an observation: the parts of the space, in order."""
        return self.interface.observation_names

    def situation(self, task: Any) -> Any:
        """Return what of a task an episode depends on, as the family says."""
        return task if self.recipe.situation is None else self.recipe.situation(task)

    def open_pool(self, num_workers: int) -> WorkerPool:
        """Return workers that host this environment; nothing is started yet."""
        how = self.recipe
        return WorkerPool(
            how.make_env, self.reward_kind, self.interface.spaces, num_workers, how.time_limit
        )

    def check_shown(self, kind: ObservedReward) -> None:
        """Refuse a reward of another kind than the environment gives: it has one at a time.

        Raises:
            ValueError: the kind is another one.
        """
        if kind not in ("own", self.reward_kind):
            raise ValueError(
                f"`{self.name}` gives the {self.reward_kind} reward alone, but the policy reads "
                f"the {kind} one: set `reward` to {kind}, or the policy's `observed_reward` to own."
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


def gymnasium_family(
    name: str,
    make_env: Callable[[Any, str], Any] | str,
    draw_tasks: Callable[[np.random.Generator, int], Any],
    *,
    task_names: tuple[str, ...] = ("task",),
    seed: int = 0,
    horizon: int | None = None,
    control_period: float | None = None,
    position: Callable[[Any], Any] = nowhere,
    goal: Callable[[Any], Any] = nowhere,
    situation: Callable[[Any], Any] | None = None,
    reward: Callable[..., Any] | None = None,
    time_limit: float = TIME_LIMIT,
    max_environments: int = MAX_ENVIRONMENTS,
) -> TaskFamily:
    """Return a family of tasks in a Gymnasium environment.

    The first use of the family makes one environment, to look at its spaces.

    Args:
        name: name of the family.
        make_env: returns the environment of a task (one row of what `draw_tasks` returns, as
            NumPy arrays) with the "dense" or the "sparse" reward, its second argument. An
            environment with a method `set_task(task)` is kept and given the next task; any other
            is made anew for every task. As `module:name` it is imported by the workers alone, which
            may then run in another interpreter (`--python`).
        draw_tasks: draws that many tasks, as an array with one row per task, or a pytree of them.
            They are held in JAX's single precision.
        task_names: names of these arrays in a user's `.npz` file of tasks.
        seed: fixes the family's task sets.
        horizon: steps of an episode at most; None for those of the environment's own clock
            (`TimeLimit`, `spec.max_episode_steps`).
        control_period: seconds between two steps; None for those of its `dt` or
            `metadata["render_fps"]`, times the actions that wrappers repeat.
        position: returns the planar position (metres) for figures from an observation, in JAX.
        goal: returns the planar position (metres) for figures from a task, in JAX. Figures that
            need the two are left out if one is `nowhere`.
        situation: returns what of a task an episode depends on, in JAX; None for all of it. Tasks
            of one situation share the episodes of a search's prior, which needs `reward` to judge
            them in each.
        reward: the environment's own reward as a function of (observation, control, next
            observation, task, "dense" or "sparse") in JAX; checked against the environment's before
            a run starts.
        time_limit: seconds that one call of an environment may take before it counts as hanging.
        max_environments: adaptation takes fewer tasks at a time to keep no more environments
            than that; each episode that is played at the same time has one.

    Raises:
        ValueError: `situation` is given without `reward`.
    """
    if situation is not None and reward is None:
        raise ValueError(
            f"`situation` of `{name}` needs `reward`: the environment can only be asked for the "
            "reward of the task that it plays."
        )
    recipe = Recipe(make_env, time_limit, max_environments, position, goal, situation, reward)

    @cache
    def family_class() -> type[AbstractGymnasiumEnv]:
        found = _look_at(name, recipe, task_row(family.task_set("training").tasks, 0))
        return _family_class(name, found, recipe, control_period)

    def make(
        variant: Variant = "reference",
        reward_kind: RewardKind = "dense",
        sparse_radius: float = 0.0,
    ) -> AbstractGymnasiumEnv:
        """A Gymnasium environment."""
        _refuse_settings(name, variant, sparse_radius)
        return _instance(family_class(), horizon, reward_kind)

    family = TaskFamily(name, make, draw_tasks, task_names, seed)
    return family


def _refuse_settings(name: str, variant: Variant, sparse_radius: float) -> None:
    if variant != "reference" or sparse_radius:
        raise ValueError(
            f"`variant` and `sparse_radius` have no meaning in `{name}`, whose rewards are "
            "its environment's own: leave them out."
        )


def _instance(
    kind: type[AbstractGymnasiumEnv], horizon: int | None, reward_kind: RewardKind
) -> AbstractGymnasiumEnv:
    return kind(
        horizon=_known(
            kind.name,
            "horizon",
            horizon,
            kind.interface.max_episode_steps,
            "it has no `TimeLimit` and no `spec.max_episode_steps`",
        ),
        observation_size=kind.interface.observation_size,
        action_size=len(kind.interface.lower),
        reward_kind=reward_kind,
    )


def _family_class(
    family_name: str, found: Interface, how: Recipe, period: float | None
) -> type[AbstractGymnasiumEnv]:
    class GymnasiumEnv(AbstractGymnasiumEnv):
        """A Gymnasium environment."""

        name: ClassVar[str] = family_name
        control_period: ClassVar[float] = _known(
            family_name, "control_period", period, found.control_period, found.doubt
        )
        action_kind: ClassVar[ActionKind] = "discrete" if found.discrete else "continuous"
        planar: ClassVar[bool] = nowhere not in (how.position, how.goal)
        interface: ClassVar[Interface] = found
        recipe: ClassVar[Recipe] = how

    return GymnasiumEnv


def task_row(tasks: Any, row: int) -> Any:
    """Return one task as `make_env` and `set_task` get it: NumPy arrays of single precision."""
    return jax.tree.map(lambda x: np.asarray(jnp.asarray(x)[row]), tasks)


def _look_at(name: str, recipe: Recipe, task: Any) -> Interface:
    # In a process of its own, where it may hang or crash.
    try:
        with contextlib.closing(
            WorkerPool(recipe.make_env, "dense", None, 1, recipe.time_limit)
        ) as pool:
            return pool.describe(pack_task(task))
    except (WorkerError, InterfaceError) as error:
        reason = error.reason if isinstance(error, WorkerError) else error
        raise InterfaceError(f"`{name}`, task 0: {reason}") from error


def _known(name: str, argument: str, given: Any, found: Any, doubt: str) -> Any:
    if given is None and found is None:
        raise InterfaceError(
            f"`{argument}` must be given for `{name}`: its environment does not say, as {doubt}."
        )
    return found if given is None else given
