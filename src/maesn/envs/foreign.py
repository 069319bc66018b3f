"""Families of environments that others wrote, with Gymnasium's interface."""

import contextlib
from collections.abc import Callable
from functools import cache
from typing import Any, ClassVar

import numpy as np

from maesn.axes import ActionKind
from maesn.envs.base import RewardKind, Variant
from maesn.envs.hosted import AbstractGymnasiumEnv, Recipe, nowhere, task_row
from maesn.envs.tasks import TaskFamily
from maesn.foreign import Interface, InterfaceError, WorkerError, WorkerPool, pack_task

# Seconds. Making an environment can take long on a machine that does much else.
TIME_LIMIT = 120.0
# Hosted environments take memory: about 20 MB each where a model has meshes.
MAX_ENVIRONMENTS = 500


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
    defines_success: bool = True,
    time_limit: float = TIME_LIMIT,
    max_environments: int = MAX_ENVIRONMENTS,
    python: str = "",
    interface: Interface | None = None,
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
        defines_success: whether the environment's `info` says that a task is solved; if not, tables
            have a dash for success, and logs and figures leave it out.
        time_limit: seconds that one call of an environment may take before it counts as hanging.
        max_environments: adaptation takes fewer tasks at a time to keep no more environments
            than that; each episode that is played at the same time has one.
        python: path of the interpreter in which `make_env` is imported, from the current directory,
            such as `.venv-arm/bin/python`; `--python` names another. Where there is no such file,
            it is the library's own.
        interface: what the environments look like, so that none needs to be made to see it.

    Raises:
        ValueError: `situation` is given without `reward`.
    """
    if situation is not None and reward is None:
        raise ValueError(
            f"`situation` of `{name}` needs `reward`: the environment can only be asked for the "
            "reward of the task that it plays."
        )
    recipe = Recipe(
        make_env, time_limit, max_environments, position, goal, situation, reward, python
    )

    @cache
    def family_class() -> type[AbstractGymnasiumEnv]:
        tasks = family.task_set("training").tasks
        found = interface or _look_at(name, recipe, task_row(tasks, 0))
        return _family_class(name, found, recipe, control_period, has_success=defines_success)

    def make(
        variant: Variant = "reference",
        reward_kind: RewardKind = "dense",
        sparse_radius: float = 0.0,
    ) -> AbstractGymnasiumEnv:
        """A Gymnasium environment."""
        if variant != "reference" or sparse_radius:
            raise ValueError(
                f"`variant` and `sparse_radius` have no meaning in `{name}`, whose rewards are "
                "its environment's own: leave them out."
            )
        kind = family_class()
        found, lacks = kind.interface, "it has no `TimeLimit` and no `spec.max_episode_steps`"
        return kind(
            horizon=_known(name, "horizon", horizon, found.max_episode_steps, lacks),
            observation_size=found.observation_size,
            action_size=len(found.lower),
            reward_kind=reward_kind,
        )

    family = TaskFamily(name, make, draw_tasks, task_names, seed)
    return family


def _family_class(
    family_name: str, found: Interface, how: Recipe, period: float | None, *, has_success: bool
) -> type[AbstractGymnasiumEnv]:
    class GymnasiumEnv(AbstractGymnasiumEnv):
        """A Gymnasium environment."""

        name: ClassVar[str] = family_name
        control_period: ClassVar[float] = _known(
            family_name, "control_period", period, found.control_period, found.doubt
        )
        action_kind: ClassVar[ActionKind] = "discrete" if found.discrete else "continuous"
        defines_success: ClassVar[bool] = has_success
        planar: ClassVar[bool] = nowhere not in (how.position, how.goal)
        interface: ClassVar[Interface] = found
        recipe: ClassVar[Recipe] = how

    return GymnasiumEnv


def _look_at(name: str, recipe: Recipe, task: Any) -> Interface:
    # In a process of its own, where it may hang or crash.
    try:
        with contextlib.closing(
            WorkerPool(recipe.make_env, "dense", None, 1, recipe.time_limit, recipe.python)
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
