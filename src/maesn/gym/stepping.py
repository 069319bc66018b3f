"""Episodes of one family, stepped from outside: what both kinds of Gymnasium environment share."""

from collections.abc import Sequence
from functools import partial
from inspect import signature
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from jaxtyping import Array, Bool, Float, Int

from maesn.axes import HostReadings, Readings
from maesn.envs import AnyEnv, RewardKind, TaskFamily, Variant
from maesn.envs.base import Reward, Start
from maesn.envs.sources import find_tasks, resolve_family
from maesn.gym.settings import TaskChoice, checked_task, make_steppable
from maesn.worlds import EpisodeError, Scene, SimulationFailure, arena, open_stepper
from maesn.worlds.outcome import observe

# Size of the pictures, in pixels.
WIDTH, HEIGHT = 480, 360


class Glimpse(NamedTuple):
    """Observations of the present states, one row for each episode."""

    observation: Float[np.ndarray, "episode observation"]
    solved: Bool[np.ndarray, " episode"]
    """Whether the goal region is reached in this state."""


class Transition(NamedTuple):
    """The result of a step, one row for each episode."""

    glimpse: Glimpse
    reward: Float[np.ndarray, " episode"]
    goal_reward: Float[np.ndarray, " episode"]
    """The part of `reward` that depends on the goal; the rest are control costs and the like."""
    terminated: Bool[np.ndarray, " episode"]
    truncated: Bool[np.ndarray, " episode"]


class Stepper:
    """Episodes of one family that advance together, each in a task of its own.

    Args:
        family: of tasks: the name of one that comes with the library, `module:name` of your own,
            or itself.
        num_episodes: how many advance together.
        task: index of the task of every episode, or of each; None to draw one at every start.
        tasks: the set that the index counts in: training, validation, test, ood, final, or the
            path of an `.npz` file.
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
        self.env: AnyEnv = make_steppable(family, reward, variant, sparse_radius)
        self.tasks = find_tasks(tasks, family)
        self.num_episodes = num_episodes
        self._chosen = checked_task(task, len(self.tasks), num_episodes)
        self._stepper = open_stepper(self.env, num_threads)
        self.task_index = np.zeros(num_episodes, np.int64)
        self._present: Any = None  # the tasks of these indices
        self._readings: HostReadings = {}
        self._steps = np.zeros(num_episodes, np.int64)

    @property
    def observation_space(self) -> Box:
        """Space of one episode: unbounded, in the order and units of the environment's page."""
        return Box(-np.inf, np.inf, (self.env.observation_size,), np.float32)

    @property
    def action_space(self) -> Box:
        """Space of one episode: [-1, 1] is the actuators' range, see `docs/howto/gymnasium.md`."""
        return Box(-1.0, 1.0, (self.env.action_size,), np.float32)

    def choose(self, task: TaskChoice = None) -> Int[np.ndarray, " episode"] | None:
        """Return the index of the task of each episode; None if they are to be drawn.

        Args:
            task: index of the task, for all or for each episode; None for what was chosen when
                the environment was made.

        Raises:
            ValueError: there is no such task.
        """
        asked = checked_task(task, len(self.tasks), self.num_episodes)
        return self._chosen if asked is None else asked

    def begin(
        self,
        rows: Int[np.ndarray, " row"],
        streams: Sequence[np.random.Generator],
        chosen: Int[np.ndarray, " episode"] | None,
    ) -> Glimpse:
        """Start some episodes anew.

        Args:
            rows: indices of the episodes, ascending.
            streams: one for every episode; those of `rows` draw the start, and the task if it is
                not chosen.
            chosen: the index of the task of each episode; None to draw them.

        Returns:
            The states of all episodes.

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
        begun = jax.tree.map(lambda x: np.asarray(x)[rows], (start, self._present))
        try:
            readings = self._stepper.begin(*begun, None if len(rows) == self.num_episodes else rows)
        except SimulationFailure as failure:
            raise self._error(failure) from failure
        self._readings, self._steps[rows] = _single(readings), 0
        return Glimpse(*_seen(_look(self.env, self._readings, self._present)))

    def step(
        self, action: Float[np.ndarray, "episode action"], ended: Bool[np.ndarray, " episode"]
    ) -> Transition:
        """Advance all episodes by one step.

        Args:
            action: an element of the action space; beyond it the actuators saturate.
            ended: episodes that are over. What happens to them means nothing.

        Raises:
            EpisodeError: the physics of an episode blew up, or an observation or a reward is not
                finite.
        """
        before, action = self._readings, action.astype(np.float32)
        control = np.where(ended[:, None], 0.0, np.asarray(_control(self.env, action)))
        try:
            self._readings = _single(self._stepper.step(control, ended))
        except SimulationFailure as failure:
            raise self._error(failure) from failure
        judged = _judge(self.env, before, action, self._readings, self._present)
        glimpse, reward, terminated, cut = judged
        total, goal, terminated, cut = _seen((reward.total, reward.goal, terminated, cut))
        # An observation at the task's own end may be anything: no policy acts on it.
        self._refuse("observation", np.isfinite(glimpse[0]).all(1) | ended | terminated)
        self._refuse("reward", np.isfinite(total) | ended)
        self._steps += 1
        out_of_time = (self._steps >= self.env.horizon) | cut
        out_of_time &= ~terminated
        return Transition(Glimpse(*_seen(glimpse)), total, goal, terminated, out_of_time)

    def open_scene(self) -> Scene:
        """Return the scene that draws the states.

        Raises:
            RenderingError: the system has no library to draw with.
            ResetNeeded: no episode has begun.
        """
        if not self._readings:
            raise ResetNeeded("there is no state to draw yet: call `reset` before `render`.")
        view = arena(self.env, self.tasks.tasks, self._readings)
        return Scene(self.env, view, WIDTH, HEIGHT)

    def draw(self, scene: Scene, episode: int) -> np.ndarray:
        """Return a picture of the present state of one episode."""
        now = {name: value[episode] for name, value in self._readings.items()}
        return scene.draw(now, jax.tree.map(lambda x: x[episode], self._present))

    def close(self) -> None:
        """Release the engine's threads and memory; may be called twice."""
        self._stepper.close()

    def _refuse(self, what: str, sound: Bool[np.ndarray, " episode"]) -> None:
        if not sound.all():
            row = int(np.argmin(sound))
            raise self._error(SimulationFailure(row, f"the {what} is not finite"))

    def _error(self, failure: SimulationFailure) -> EpisodeError:
        row = failure.simulation
        task, step = int(self.task_index[row]), int(self._steps[row])
        return EpisodeError(self.env.name, task, row, step, failure.reason)


SETTINGS = tuple(
    name for name, one in signature(Stepper).parameters.items() if one.kind is one.KEYWORD_ONLY
)
"""Names of all that may be set."""


def _single(readings: HostReadings) -> HostReadings:
    """Return readings in the precision in which the library's worlds judge them."""
    # What blew up may be finite in double precision and infinite in single.
    with np.errstate(over="ignore"):
        return {name: value.astype(np.float32) for name, value in readings.items()}


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
