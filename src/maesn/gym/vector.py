"""A family of tasks as a Gymnasium vector environment: many episodes on the batched engine."""

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from gymnasium import logger
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Int

from maesn.envs import TaskSet
from maesn.gym.settings import NO_EPISODE, RENDER_MODES, refuse_unknown
from maesn.gym.stepping import SETTINGS, Information, Stepper

Seeds: TypeAlias = int | np.integer[Any] | Sequence[int | None] | None

_MODES = (AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED)


class TaskVectorEnv(VectorEnv[Any, Any, Any]):
    """Many episodes of a family, moved together; `gymnasium.make_vec` makes it.

    Episode i is, bit for bit, the one that `TaskEnv` plays when it is reset with `seed + i` and
    given the same actions.

    Args:
        family: as for `Stepper`, like every other setting.
        num_envs: how many episodes are played at once.
        render_mode: `rgb_array` for pictures from `render`; None for none.
        autoreset_mode: `NEXT_STEP`: the step after the end of an episode ignores the action and
            returns the start of the next one, with reward 0. `DISABLED`: episodes that have ended
            must be reset before the next step, `reset(options={"reset_mask": ended})`.
        settings: `task` (for all or for each episode), `tasks`, `reward`, `variant`,
            `sparse_radius`, `num_threads`; see `Stepper`.

    Raises:
        RunError: there is no such family or set of tasks.
        ValueError: a setting is unknown or wrong.
    """

    def __init__(
        self,
        family: Any = "wheeled",
        num_envs: int = 1,
        *,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **settings: Any,
    ) -> None:
        self._mode = _checked_mode(autoreset_mode)
        refuse_unknown("a setting", settings, SETTINGS)
        refuse_unknown("a render mode", filter(None, [render_mode]), RENDER_MODES)
        self._stepper = Stepper(family, num_envs, **settings)
        self.num_envs = num_envs
        self.single_observation_space = self._stepper.observation_space
        self.single_action_space = self._stepper.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.render_mode = render_mode
        self.metadata = self._stepper.metadata | {"autoreset_mode": self._mode}
        self._streams = [seeding.np_random()[0] for _ in range(num_envs)]
        self._running = False

    @property
    def tasks(self) -> TaskSet:
        """The tasks that an index counts in: `len(envs.tasks)`, `envs.tasks[3]`."""
        return self._stepper.tasks

    def reset(
        self, *, seed: Seeds = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start episodes; return observations and information of all: `task`, `is_success`.

        Args:
            seed: seed of all later draws: episode i draws with `seed + i`, or with the i-th of
                several; None to go on drawing as before.
            options: `{"task": index}` chooses the task of these episodes, for all of them or for
                each; `{"reset_mask": mask}` starts those of the mask and leaves the others alone.

        Raises:
            ValueError: there is no such option or task, or mask or seeds are not one for each
                episode.
        """
        options = options or {}
        refuse_unknown("an option", options, ("task", "reset_mask"))
        rows = self._rows_to_reset(options)
        chosen = self._stepper.choose(options.get("task"))
        asked = zip(rows, self._seeds(seed)[rows], strict=True)
        fresh = {row: seeding.np_random(int(own))[0] for row, own in asked if own is not None}
        for row, stream in fresh.items():
            self._streams[row] = stream
        observation, information = self._stepper.begin(rows, self._streams, chosen)
        self._running = True
        return observation, _masked(information)

    def step(self, actions: Any) -> tuple[Any, ...]:
        """Advance all episodes by one control step; returns and raises as `TaskEnv.step`, in rows.

        ResetNeeded also says that some episodes have ended and wait for a reset.
        """
        over = self._stepper.ended
        self._refuse_step(over)
        observation, reward, terminated, truncated, information = self._stepper.step(actions)
        if over.any():
            rows = np.flatnonzero(over)
            observation, begun = self._stepper.begin(rows, self._streams, self._stepper.choose())
            information |= begun
        return observation, reward, terminated, truncated, _masked(information)

    def render(self) -> Any:
        """Return a picture of the present state of every episode, or None without a mode."""
        if self.render_mode is None:
            logger.warn("`render` needs `render_mode='rgb_array'` in `gymnasium.make_vec`.")
            return None
        return tuple(self._stepper.pictures())

    def close_extras(self, **_: Any) -> None:
        """Release the engine and the drawing library."""
        self._stepper.close()

    def _rows_to_reset(self, options: dict[str, Any]) -> Int[np.ndarray, " row"]:
        mask = np.asarray(options.get("reset_mask", np.ones(self.num_envs, bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise ValueError(
                f"`reset_mask` must be {self.num_envs} booleans with at least one True, got {mask}."
            )
        if not self._running and not mask.all():
            raise ResetNeeded("no episode is running: `reset` all of them first.")
        return np.flatnonzero(mask)

    def _seeds(self, seed: Seeds) -> np.ndarray:
        if isinstance(seed, int | np.integer):
            seed = [int(seed) + row for row in range(self.num_envs)]
        seeds = np.array([None] * self.num_envs if seed is None else seed, object)
        if len(seeds) != self.num_envs:
            raise ValueError(
                f"`seed` must be one number or one for each of {self.num_envs} episodes, got "
                f"{len(seeds)}."
            )
        return seeds

    def _refuse_step(self, over: np.ndarray) -> None:
        if not self._running:
            raise ResetNeeded(NO_EPISODE)
        if over.any() and self._mode is AutoresetMode.DISABLED:
            raise ResetNeeded(
                f"the episodes {np.flatnonzero(over).tolist()} have ended and are not reset by "
                'themselves: call `reset(options={"reset_mask": mask})` before `step`.'
            )


def _masked(information: Information) -> dict[str, Any]:
    """Return information as Gymnasium wants it: with a mask of the episodes that have it."""
    return information | {f"_{name}": np.ones(len(x), bool) for name, x in information.items()}


def _checked_mode(mode: AutoresetMode | str) -> AutoresetMode:
    wanted = AutoresetMode(mode)
    if wanted not in _MODES:
        names = " or ".join(known.name for known in _MODES)
        raise ValueError(
            f"`autoreset_mode` must be {names}, got {wanted.name}: its observation after the last "
            "step would belong to the next episode."
        )
    return wanted
