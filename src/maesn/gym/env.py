"""A family of tasks as a Gymnasium environment: one episode at a time."""

from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Float

from maesn.envs import TaskSet
from maesn.gym.settings import NO_EPISODE, RENDER_MODES, refuse_unknown
from maesn.gym.stepping import SETTINGS, Information, Stepper

Observation = Float[np.ndarray, " observation"]

# A single episode needs a single thread.
_SETTINGS = tuple(name for name in SETTINGS if name != "num_threads")


class TaskEnv(gymnasium.Env[Any, Any]):
    """One episode at a time of a family, in a task that is drawn or chosen.

    Args:
        family: as for `Stepper`, like every other setting.
        render_mode: `rgb_array` for pictures from `render`; None for none.
        settings: `task`, `tasks`, `reward`, `variant`, `sparse_radius`.

    Raises:
        RunError: there is no such family or set of tasks.
        ValueError: a setting is unknown or wrong.
    """

    # Shared by all families; how many pictures a second shows is each environment's own.
    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012

    def __init__(
        self, family: Any = "wheeled", *, render_mode: str | None = None, **settings: Any
    ) -> None:
        refuse_unknown("a setting", settings, _SETTINGS)
        refuse_unknown("a render mode", filter(None, [render_mode]), RENDER_MODES)
        self._stepper = Stepper(family, 1, num_threads=1, **settings)
        self.observation_space = self._stepper.observation_space
        self.action_space = self._stepper.action_space
        self.render_mode = render_mode
        self.metadata = self._stepper.metadata

    @property
    def tasks(self) -> TaskSet:
        """The tasks that an index counts in: `len(env.tasks)`, `env.tasks[3]`."""
        return self._stepper.tasks

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; return observation and information: `task`, `is_success`.

        Args:
            seed: seed of all later draws; None to go on drawing as before.
            options: `{"task": index}` chooses the task of this episode.

        Raises:
            ValueError: there is no such option or task.
        """
        options = options or {}
        refuse_unknown("an option", options, ("task",))
        chosen = self._stepper.choose(options.get("task"))
        super().reset(seed=seed)
        observation, information = self._stepper.begin(np.arange(1), [self.np_random], chosen)
        return observation[0], _single(information)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance by one control step; beyond the action space the actuators saturate.

        Returns:
            Observation, reward, whether the episode has terminated, whether it has run out of
            time, and information: `task`, `is_success`, `goal_reward`.

        Raises:
            EpisodeError: the physics blew up, or something is no number.
            ResetNeeded: no episode is running.
            ValueError: the action has another shape than its space.
        """
        if self._stepper.ended[0]:
            raise gymnasium.error.ResetNeeded(NO_EPISODE)
        observation, *numbers, information = self._stepper.step(np.asarray(action)[None])
        reward, terminated, truncated = (row.item() for row in numbers)
        return observation[0], reward, terminated, truncated, _single(information)

    def render(self) -> Any:
        """Return a picture of the present state, or None without a `render_mode`."""
        if self.render_mode is None:
            gymnasium.logger.warn("`render` needs `render_mode='rgb_array'` in `gymnasium.make`.")
            return None
        return self._stepper.pictures()[0]

    def close(self) -> None:
        """Release the engine and the drawing library; may be called twice."""
        self._stepper.close()


def _single(information: Information) -> dict[str, Any]:
    return {name: row.item() for name, row in information.items()}
