"""A family of tasks in an environment that others wrote: Meta-World's ML1 `reach-v3`.

A robot arm has to reach a hidden point in space. Meta-World 3.1.1 asks for MuJoCo 3.3.0. That is
too old for the engine of the library's own robots, which this family does not use. So it needs a
virtual environment of its own:

    python3.11 -m venv .venv-external
    .venv-external/bin/pip install -e '.[gym]' metaworld==3.1.1
    export PYTHONPATH=examples
    .venv-external/bin/maesn train maesn --family metaworld_reach:family --run runs/reach
    .venv-external/bin/maesn adapt runs/reach --family metaworld_reach:family

Dense reward is Meta-World's own; sparse reward is 1 where Meta-World reports success and 0
elsewhere. Each environment takes about 20 MB, and there is one for each episode that is played at
a time: 400 in training by default, which is 8 GB, and 2 GB with
`--meta-batch-size 10 --episodes-per-task 10`. Adaptation keeps 100 at most.
"""

import pickle
from typing import Any

import gymnasium
import numpy as np
from metaworld.envs.sawyer_reach_v3 import SawyerReachEnvV3
from metaworld.types import Task

from maesn.envs.foreign import gymnasium_family

# Metres. The object's start and the goal, as Meta-World draws them in `SawyerReachEnvV3`.
LOWER = np.array([-0.1, 0.6, 0.02, -0.1, 0.8, 0.05])
UPPER = np.array([0.1, 0.7, 0.02, 0.1, 0.9, 0.3])
# Metres in the plane. Meta-World draws again where the object lies nearer to the goal. It would do
# so for ever where the task is given.
CLEARANCE = 0.15
HORIZON = 150  # steps of 1/80 s, in which the hand can be anywhere; Meta-World itself ends at 500


class Reach(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Meta-World's environment with tasks that are arrays of numbers."""

    def __init__(self, reward: str) -> None:
        super().__init__(SawyerReachEnvV3())
        self.sparse = reward == "sparse"

    def set_task(self, points: np.ndarray) -> None:
        """Take another task: the object's start and the goal, 3 coordinates each, in metres."""
        task = {
            "rand_vec": points.astype(np.float64),
            "env_cls": SawyerReachEnvV3,
            "partially_observable": True,  # the goal is not among the observations
        }
        self.unwrapped.set_task(Task(env_name="reach-v3", data=pickle.dumps(task)))

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advance by one step of 1/80 s."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        chosen = info["success"] if self.sparse else reward
        return observation, float(chosen), terminated, truncated, info


def make_env(points: np.ndarray, reward: str) -> Reach:
    """Return the arm with a task, with the "dense" or "sparse" reward."""
    env = Reach(reward)
    env.set_task(points)
    return env


def draw_tasks(stream: np.random.Generator, size: int) -> np.ndarray:
    """Draw that many tasks, the object's start and the goal, `[size, 6]` in metres."""
    points = stream.uniform(LOWER, UPPER, (size, 6)).astype(np.float32)
    while (near := np.linalg.norm(points[:, 3:5] - points[:, :2], axis=1) < CLEARANCE).any():
        points[near] = stream.uniform(LOWER, UPPER, (near.sum(), 6))
    return points


family = gymnasium_family(
    "metaworld_reach",
    make_env,
    draw_tasks,
    task_names=("points",),
    seed=21,
    horizon=HORIZON,
    max_environments=100,
    position=lambda observation: observation[:2],  # of the hand, seen from above
    goal=lambda points: points[3:5],
)
