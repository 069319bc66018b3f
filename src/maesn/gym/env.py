"""A family of tasks as a Gymnasium environment: one episode at a time."""

from functools import partial
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Discrete
from jaxtyping import Array, Float

from maesn.axes import HostReadings, Readings
from maesn.envs import AnyEnv, RewardKind, TaskFamily, Variant
from maesn.envs.base import Start
from maesn.envs.hosted import AbstractGymnasiumEnv
from maesn.envs.sources import find_tasks, resolve_family
from maesn.gym.units import box_to_action, one_hot
from maesn.physics import PhysicsError
from maesn.settings import check_choice
from maesn.worlds import EpisodeError, Scene, arena, open_stepper
from maesn.worlds.outcome import observe

Observation = Float[np.ndarray, " observation"]

# Size of the pictures, in pixels.
WIDTH, HEIGHT = 480, 360


class TaskEnv(gymnasium.Env[Any, Any]):
    """One episode at a time of a family, in a task that is drawn or chosen.

    The observation space is unbounded, in the order and units of the environment's page. The action
    space is [-1, 1] for the actuators' range, or the numbers of the choices.

    Args:
        family: of tasks: the name of one that comes with the library, `module:name` of your own,
            or itself.
        task: index of the task of every episode; None to draw one at every start.
        tasks: the set that the index counts in: training, validation, test, ood, final, final-2,
            ood-validation, or the path of an `.npz` file.
        reward: dense or sparse.
        variant: whose reward formulas.
        sparse_radius: radius of the goal region in metres; None for the family's own.
        render_mode: `rgb_array` for pictures from `render`; None for none.

    Raises:
        RunError: there is no such family or set of tasks.
        ValueError: another setting is wrong.
    """

    # Shared by all families; how many pictures a second shows is each environment's own.
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}  # noqa: RUF012

    def __init__(
        self,
        family: str | TaskFamily = "wheeled",
        *,
        task: int | None = None,
        tasks: str = "training",
        reward: RewardKind = "dense",
        variant: Variant = "reference",
        sparse_radius: float | None = None,
        render_mode: str | None = None,
    ) -> None:
        family = resolve_family(family) if isinstance(family, str) else family
        check_choice("reward", reward, RewardKind)  # environments know it by another name
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"`render_mode` must be None or 'rgb_array', got {render_mode!r}.")
        radius = {} if sparse_radius is None else {"sparse_radius": sparse_radius}
        self._inner: AnyEnv = family.make_env(variant=variant, reward_kind=reward, **radius)
        if isinstance(self._inner, AbstractGymnasiumEnv):
            raise ValueError(
                f"`family` must be moved by the library, but `{family.name}` is a Gymnasium "
                "environment already: play it with `maesn.Collector`."
            )
        self.tasks = find_tasks(tasks, family)
        """The tasks that an index counts in: `len(env.tasks)`, `env.tasks[3]`."""
        self._chosen = self._checked(task)
        size, is_discrete = self._inner.action_size, self._inner.action_kind == "discrete"
        self.observation_space = Box(-np.inf, np.inf, (self._inner.observation_size,), np.float32)
        self.action_space = Discrete(size) if is_discrete else Box(-1.0, 1.0, (size,), np.float32)
        self._to_action = one_hot(size) if is_discrete else box_to_action(self._inner)
        self.render_mode = render_mode
        rate = round(1 / self._inner.control_period)
        self.metadata = TaskEnv.metadata | {"render_fps": max(rate, 1)}
        self._stepper = open_stepper(self._inner, num_threads=1)
        self._scene: Scene | None = None
        self._readings: HostReadings = {}
        """Of the present state, with an axis of one simulation."""
        self._task_index, self._task = 0, None
        self._steps, self._ended = 0, True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; return observation and information: `task`, `is_success`.

        A family that defines no success has no `is_success`.

        Args:
            seed: seed of all later draws; None to go on drawing as before.
            options: `{"task": index}` chooses the task of this episode.

        Raises:
            ValueError: there is no such option or task.
        """
        options = options or {}
        if options.keys() - {"task"}:
            raise ValueError(f"`options` may hold `task` alone, got {', '.join(options)}.")
        chosen = self._checked(options.get("task"))
        chosen = self._chosen if chosen is None else chosen
        super().reset(seed=seed)
        drawn = self.np_random.integers(len(self.tasks)) if chosen is None else chosen
        self._task_index, self._steps = int(drawn), 0
        self._task = jax.tree.map(jnp.asarray, self.tasks[self._task_index])
        start = _start(self._inner, self.np_random.integers(2**32, dtype=np.uint32), self._task)
        try:
            self._readings = self._stepper.begin(start, None)
        except PhysicsError as failure:
            raise self._error(failure.reason) from failure
        self._ended = False
        observation, solved = _look(self._inner, self._readings, self._task)
        return np.array(observation), self._information(solved)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance by one control step; beyond the action space the actuators saturate.

        Returns:
            Observation, reward, whether the episode has terminated, whether it has run out of
            time, and information: `task`, `is_success`, `goal_reward`.

        Raises:
            EpisodeError: the physics blew up, or something is no number.
            ResetNeeded: no episode is running.
            ValueError: the action is not of its space's shape, or no choice.
        """
        if self._ended:
            raise ResetNeeded("no episode is running: call `reset` before `step`.")
        before, action = self._readings, np.asarray(action, np.float32)
        if action.shape != self.action_space.shape:
            raise ValueError(
                f"`action` must have the shape {self.action_space.shape}, got {action.shape}."
            )
        action = self._to_action(action)
        control = np.asarray(_control(self._inner, action))
        try:
            self._readings = self._stepper.step(control, np.zeros(1, bool))
        except PhysicsError as failure:
            raise self._error(failure.reason) from failure
        judged = _judge(self._inner, before, action, self._readings, self._task)
        observation, *numbers = map(np.array, judged)
        solved, reward, goal_reward, terminated, truncated = (one.item() for one in numbers)
        # An observation at the task's own end may be anything: no policy acts on it.
        if not (terminated or np.isfinite(observation).all()):
            raise self._error("the observation is not finite")
        if not np.isfinite(reward):
            raise self._error("the reward is not finite")
        self._steps += 1
        truncated = (truncated or self._steps >= self._inner.horizon) and not terminated
        self._ended = terminated or truncated
        information = self._information(solved) | {"goal_reward": goal_reward}
        return observation, reward, terminated, truncated, information

    def render(self) -> Any:
        """Return a picture of the present state, or None without a `render_mode`.

        Raises:
            RenderingError: the system has no library to draw with.
            ResetNeeded: no episode has begun.
        """
        if self.render_mode is None:
            gymnasium.logger.warn("`render` needs `render_mode='rgb_array'` in `gymnasium.make`.")
            return None
        if not self._readings:
            raise ResetNeeded("there is no state to draw yet: call `reset` before `render`.")
        if self._scene is None:
            view = arena(self._inner, self.tasks.tasks, self._readings)
            self._scene = Scene(self._inner, view, WIDTH, HEIGHT)
        return self._scene.draw(_first(self._readings), self._task)

    def close(self) -> None:
        """Release the engine and the drawing library; may be called twice."""
        self._stepper.close()
        self._ended = True
        if self._scene is not None:
            self._scene.close()

    def _checked(self, task: Any) -> int | None:
        whole = isinstance(task, int | np.integer) and not isinstance(task, bool)
        if task is not None and not (whole and 0 <= task < len(self.tasks)):
            raise ValueError(
                f"`task` must be an index from 0 to {len(self.tasks) - 1}, got {task!r}."
            )
        return task

    def _information(self, solved: Any) -> dict[str, Any]:
        success = {"is_success": bool(solved)} if self._inner.defines_success else {}
        return {"task": self._task_index} | success

    def _error(self, reason: str) -> EpisodeError:
        return EpisodeError(self._inner.name, self._task_index, 0, self._steps, reason)


def _first(readings: Any) -> Any:
    return jax.tree.map(lambda x: x[0], readings)


@partial(jax.jit, static_argnums=0)
def _start(env: AnyEnv, seed: Array, task: Any) -> Start:
    return jax.tree.map(lambda x: x[None], env.start(jax.random.key(seed), task))


@partial(jax.jit, static_argnums=0)
def _control(env: AnyEnv, action: Array) -> Array:
    return env.control(action)[None]


@partial(jax.jit, static_argnums=0)
def _look(env: AnyEnv, readings: Readings, task: Any) -> tuple[Array, Array]:
    now = _first(readings)
    return observe(env, now, task), env.solved(now, task)


@partial(jax.jit, static_argnums=0)
def _judge(
    env: AnyEnv, readings: Readings, action: Array, next_readings: Readings, task: Any
) -> tuple[Array, ...]:
    before, after = _first(readings), _first(next_readings)
    reward = env.reward(before, action, after, task)
    ends = env.terminated(after), env.truncated(after)
    return observe(env, after, task), env.solved(after, task), reward.total, reward.goal, *ends
