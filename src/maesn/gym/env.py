"""A family of tasks as a Gymnasium environment: one episode at a time."""

from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Float

from maesn.gym.settings import (
    RENDER_MODES,
    checked_action,
    checked_render_mode,
    refuse_unknown,
)
from maesn.gym.stepping import SETTINGS, Glimpse, Stepper
from maesn.worlds import Scene

Observation = Float[np.ndarray, " observation"]

# A single episode needs a single thread.
_SETTINGS = tuple(name for name in SETTINGS if name != "num_threads")


class TaskEnv(gymnasium.Env[Any, Any]):
    """One episode at a time of a family, in a task that is drawn or chosen.

    Args:
        family: as for `Stepper`, like every other setting.
        render_mode: `rgb_array` for pictures from `render`; None for none.
        settings: `task`, `tasks`, `reward`, `variant`, `sparse_radius`; see `Stepper`.

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
        self._stepper = Stepper(family, 1, num_threads=1, **settings)
        self.observation_space = self._stepper.observation_space
        self.action_space = self._stepper.action_space
        self.render_mode = checked_render_mode(render_mode)
        self.metadata = metadata_of(self._stepper)
        self._scene: Scene | None = None
        self._ended = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: seed of all later draws; None to go on drawing as before.
            options: `{"task": index}` chooses the task of this episode.

        Returns:
            Observation and information: `task`, `is_success`.

        Raises:
            ValueError: there is no such option or task.
        """
        options = options or {}
        refuse_unknown("an option", options, ("task",))
        chosen = self._stepper.choose(options.get("task"))
        super().reset(seed=seed)
        glimpse = self._stepper.begin(np.zeros(1, np.int64), [self.np_random], chosen)
        self._ended = False
        return glimpse.observation[0], self._information(glimpse)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance by one control step.

        Args:
            action: an element of the action space; beyond it the actuators saturate.

        Returns:
            Observation, reward, whether the episode has terminated, whether it has run out of
            time, and information: `task`, `is_success`, `goal_reward`.

        Raises:
            EpisodeError: the physics blew up, or something is no number.
            ValueError: the action has another shape than its space.
        """
        if self._ended:
            raise gymnasium.error.ResetNeeded("no episode is running: call `reset` before `step`.")
        action = checked_action(action, self.action_space)
        after = self._stepper.step(action[None], np.zeros(1, bool))
        reward = float(after.reward[0])
        terminated, truncated = bool(after.terminated[0]), bool(after.truncated[0])
        self._ended = terminated or truncated
        goal = {"goal_reward": float(after.goal_reward[0])}
        information = self._information(after.glimpse) | goal
        return after.glimpse.observation[0], reward, terminated, truncated, information

    def render(self) -> Any:
        """Return a picture of the present state, or None without a `render_mode`."""
        if self.render_mode is None:
            gymnasium.logger.warn("`render` needs `render_mode='rgb_array'` in `gymnasium.make`.")
            return None
        if self._scene is None:
            self._scene = self._stepper.open_scene()
        return self._stepper.draw(self._scene, 0)

    def close(self) -> None:
        """Release the engine and the drawing library; may be called twice."""
        self._stepper.close()
        if self._scene is not None:
            self._scene.close()

    def _information(self, glimpse: Glimpse) -> dict[str, Any]:
        return {"task": int(self._stepper.task_index[0]), "is_success": bool(glimpse.solved[0])}


def metadata_of(stepper: Stepper) -> dict[str, Any]:
    """Return what Gymnasium wants to know of the pictures."""
    rate = round(1 / stepper.env.control_period)
    return {"render_modes": list(RENDER_MODES), "render_fps": max(rate, 1)}
