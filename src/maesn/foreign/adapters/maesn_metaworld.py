"""Meta-World's ML1 environments, as `maesn.envs.metaworld` describes them, in a worker's process.

This runs in Meta-World's interpreter, so it imports nothing of this library.
"""

import pickle
from functools import partial
from typing import Any

import numpy as np

try:
    import gymnasium
    from metaworld import envs
    from metaworld.types import Task
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        f"{error}. `make metaworld` installs Meta-World in .venv-metaworld, where it is looked for "
        "in the current directory; `--python` names another interpreter that has it"
    ) from error


class Ml1(gymnasium.Wrapper):
    """An environment whose tasks are arrays of numbers, with either reward."""

    def __init__(self, kind: Any, points: np.ndarray, reward: str) -> None:
        super().__init__(kind(reward_function_version="v2"))
        self._kind, self._is_sparse = kind, reward == "sparse"
        self.set_task(points)

    def set_task(self, points: np.ndarray) -> None:
        """Take another task: the object's start and the goal, 3 coordinates each, in metres."""
        task = {
            "rand_vec": points.astype(np.float64),
            "env_cls": self._kind,
            "partially_observable": True,  # the goal is not among the observations
        }
        self.unwrapped.set_task(Task(env_name=self._kind.__name__, data=pickle.dumps(task)))  # type: ignore[attr-defined]

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode. Meta-World's own `reset` ignores the seed."""
        if seed is not None:
            self.unwrapped.seed(seed)  # type: ignore[attr-defined]
        return self.env.reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advance by one step of 1/80 s."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        chosen = info["success"] if self._is_sparse else reward
        return observation, float(chosen), terminated, truncated, info


# Each makes an environment of a task and a kind of reward.
reach = partial(Ml1, envs.SawyerReachEnvV3)
push = partial(Ml1, envs.SawyerPushEnvV3)
pick_place = partial(Ml1, envs.SawyerPickPlaceEnvV3)
