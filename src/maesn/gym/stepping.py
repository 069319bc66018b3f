"""Episodes of one family, stepped from outside: what both kinds of Gymnasium environment share."""

from collections.abc import Sequence
from functools import partial
from inspect import signature
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Discrete
from jaxtyping import Array, Bool, Int

from maesn.axes import HostReadings, Readings
from maesn.envs import AnyEnv, RewardKind, TaskFamily, Variant
from maesn.envs.base import Reward, Start
from maesn.envs.sources import find_tasks, resolve_family
from maesn.gym.settings import RENDER_MODES, TaskChoice, checked_task
from maesn.gym.units import box_to_action, one_hot
from maesn.settings import check_choice
from maesn.worlds import EpisodeError, Scene, SimulationFailure, arena, open_stepper
from maesn.worlds.outcome import observe

# Size of the pictures, in pixels.
WIDTH, HEIGHT = 480, 360


Information: TypeAlias = dict[str, np.ndarray]
"""`task`, `is_success` and, after a step, `goal_reward`: one row for each episode."""


class Stepper:
    """Episodes of one family that advance together, each in a task of its own.

    Args:
        family: of tasks: the name of one that comes with the library, `module:name` of your own,
            or itself.
        num_episodes: how many advance together.
        task: index of the task of every episode, or of each; None to draw one at every start.
        tasks: the set that the index counts in: training, validation, test, ood, final, final-2,
            ood-validation, or the path of an `.npz` file.
        reward: dense or sparse.
        variant: whose reward formulas.
        sparse_radius: radius of the goal region in metres; None for the family's own.
        num_threads: threads of the MuJoCo engine; 0 means one for each CPU.

    Raises:
        RunError: there is no such family or set of tasks.
        ValueError: another setting is wrong.
    """

    def __init__(
        self,
        family: str | TaskFamily,
        num_episodes: int,
        *,
        task: TaskChoice = None,
        tasks: str = "training",
        reward: RewardKind = "dense",
        variant: Variant = "reference",
        sparse_radius: float | None = None,
        num_threads: int = 0,
    ) -> None:
        family = resolve_family(family) if isinstance(family, str) else family
        check_choice("reward", reward, RewardKind)  # environments know it by another name
        radius = {} if sparse_radius is None else {"sparse_radius": sparse_radius}
        self.env: AnyEnv = family.make_env(variant=variant, reward_kind=reward, **radius)
        if self.env.engine == "gymnasium":
            raise ValueError(
                f"`family` must be moved by the library, but `{family.name}` is a Gymnasium "
                "environment already: play it with `maesn.Collector`."
            )
        self.tasks = find_tasks(tasks, family)
        self.num_episodes = num_episodes
        self._chosen = checked_task(task, len(self.tasks), num_episodes)
        self._is_discrete = self.env.action_kind == "discrete"
        self._to_action = one_hot(self.env) if self._is_discrete else box_to_action(self.env)
        self._stepper = open_stepper(self.env, num_threads)
        self._scene: Scene | None = None
        self.task_index = np.zeros(num_episodes, np.int64)
        self.ended = np.ones(num_episodes, bool)
        self._present: Any = None  # the tasks of these indices
        self._readings: HostReadings = {}
        self._steps = np.zeros(num_episodes, np.int64)

    @property
    def metadata(self) -> dict[str, Any]:
        """What Gymnasium wants to know of the pictures."""
        rate = round(1 / self.env.control_period)
        return {"render_modes": list(RENDER_MODES), "render_fps": max(rate, 1)}

    @property
    def observation_space(self) -> Box:
        """Space of one episode: unbounded, in the order and units of the environment's page."""
        return Box(-np.inf, np.inf, (self.env.observation_size,), np.float32)

    @property
    def action_space(self) -> Box | Discrete:
        """Space of one episode: [-1, 1] is the actuators' range, or the numbers of the choices."""
        if self._is_discrete:
            return Discrete(self.env.action_size)
        return Box(-1.0, 1.0, (self.env.action_size,), np.float32)

    def choose(self, task: TaskChoice = None) -> Int[np.ndarray, " episode"] | None:
        """Return the index of the task of each episode; None if they are to be drawn.

        A task of None is what was chosen when the environment was made. Any other is for all or for
        each episode; ValueError says that there is none.
        """
        asked = checked_task(task, len(self.tasks), self.num_episodes)
        return self._chosen if asked is None else asked

    def begin(
        self,
        rows: Int[np.ndarray, " row"],
        streams: Sequence[np.random.Generator],
        chosen: Int[np.ndarray, " episode"] | None,
    ) -> tuple[np.ndarray, Information]:
        """Start some episodes anew, and return observations and information of all.

        Args:
            rows: indices of the episodes, ascending.
            streams: one for every episode; those of `rows` draw the start, and the task if it is
                not chosen.
            chosen: the index of the task of each episode; None to draw them.

        Raises:
            EpisodeError: the physics cannot begin with the state that was drawn.
        """
        seeds = np.zeros(self.num_episodes, np.uint32)
        for row in rows:
            drawn = streams[row].integers(len(self.tasks)) if chosen is None else chosen[row]
            self.task_index[row] = drawn
            seeds[row] = streams[row].integers(2**32, dtype=np.uint32)
        self._present = jax.tree.map(jnp.asarray, self.tasks[self.task_index])
        start = _start(self.env, seeds, self._present)
        start, tasks = jax.tree.map(lambda x: np.asarray(x)[rows], (start, self._present))
        some = None if len(rows) == self.num_episodes else rows
        try:
            self._readings = self._stepper.begin(start, tasks, some)
        except SimulationFailure as failure:
            raise self._error(failure) from failure
        self._steps[rows], self.ended[rows] = 0, False
        observation, solved = _seen(_look(self.env, self._readings, self._present))
        return observation, self._information(solved)

    def step(
        self, action: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Information]:
        """Advance all episodes by one step; what happens to those that have ended means nothing.

        Actions have one row for each episode; beyond the action space the actuators saturate.
        Returns and raises as `TaskEnv.step`; ValueError also of what is no choice.
        """
        before, action = self._readings, np.asarray(action, np.float32)
        size = () if self._is_discrete else (self.env.action_size,)
        wanted = (self.num_episodes, *size)
        if action.shape != wanted:
            raise ValueError(f"`action` must have the shape {wanted}, got {action.shape}.")
        action, over = self._to_action(action), self.ended
        control = np.where(over[:, None], 0.0, np.asarray(_control(self.env, action)))
        try:
            self._readings = self._stepper.step(control, over)
        except SimulationFailure as failure:
            raise self._error(failure) from failure
        judged = _judge(self.env, before, action, self._readings, self._present)
        glimpse, reward, *ends = judged
        seen = _seen((*glimpse, reward.total, reward.goal, *ends))
        observation, solved, total, goal, terminated, cut = seen
        # An observation at the task's own end may be anything: no policy acts on it.
        self._refuse("observation", np.isfinite(observation).all(1) | over | terminated)
        self._refuse("reward", np.isfinite(total) | over)
        self._steps += 1
        truncated = ((self._steps >= self.env.horizon) | cut) & ~terminated
        self.ended = over | terminated | truncated
        information = self._information(solved) | {"goal_reward": np.where(over, 0.0, goal)}
        gained = np.where(over, 0.0, total)
        return observation, gained, terminated & ~over, truncated & ~over, information

    def pictures(self) -> list[np.ndarray]:
        """Return a picture of the present state of each episode.

        Raises:
            RenderingError: the system has no library to draw with.
            ResetNeeded: no episode has begun.
        """
        if not self._readings:
            raise ResetNeeded("there is no state to draw yet: call `reset` before `render`.")
        if self._scene is None:
            view = arena(self.env, self.tasks.tasks, self._readings)
            self._scene = Scene(self.env, view, WIDTH, HEIGHT)
        rows = range(self.num_episodes)
        states, tasks = self._readings, self._present
        return [self._scene.draw(*jax.tree.map(lambda x, i=i: x[i], (states, tasks))) for i in rows]

    def close(self) -> None:
        """Release the engine and the drawing library; may be called twice."""
        self._stepper.close()
        if self._scene is not None:
            self._scene.close()

    def _information(self, solved: np.ndarray) -> Information:
        return {"task": self.task_index.copy(), "is_success": solved}

    def _refuse(self, what: str, sound: Bool[np.ndarray, " episode"]) -> None:
        if not sound.all():
            row = int(np.argmin(sound))
            raise self._error(SimulationFailure(row, 0, f"the {what} is not finite"))

    def _error(self, failure: SimulationFailure) -> EpisodeError:
        row = failure.simulation
        task, step = int(self.task_index[row]), int(self._steps[row])
        return EpisodeError(self.env.name, task, row, step, failure.reason)


SETTINGS = tuple(
    name for name, one in signature(Stepper).parameters.items() if one.kind is one.KEYWORD_ONLY
)
"""Names of all that may be set."""


def _seen(values: Any) -> Any:
    """Return copies that the caller may change."""
    return jax.tree.map(np.array, values)


@partial(jax.jit, static_argnums=0)
def _start(env: AnyEnv, seeds: Array, tasks: Any) -> Start:
    return jax.vmap(lambda seed, task: env.start(jax.random.key(seed), task))(seeds, tasks)


@partial(jax.jit, static_argnums=0)
def _control(env: AnyEnv, action: Array) -> Array:
    return jax.vmap(env.control)(action)


def _look_at(env: AnyEnv, readings: Readings, task: Any) -> tuple[Array, Array]:
    return observe(env, readings, task), env.solved(readings, task)


@partial(jax.jit, static_argnums=0)
def _look(env: AnyEnv, readings: Readings, tasks: Any) -> tuple[Array, Array]:
    return jax.vmap(partial(_look_at, env))(readings, tasks)


@partial(jax.jit, static_argnums=0)
def _judge(
    env: AnyEnv, before: Readings, action: Array, after: Readings, tasks: Any
) -> tuple[tuple[Array, Array], Reward, Array, Array]:
    def judge(before: Readings, action: Array, after: Readings, task: Any) -> Any:
        reward = env.reward(before, action, after, task)
        return _look_at(env, after, task), reward, env.terminated(after), env.truncated(after)

    return jax.vmap(judge)(before, action, after, tasks)
