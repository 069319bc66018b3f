r"""A family of tasks in an environment that others wrote: Gymnasium's `HalfCheetah-v5`.

The cheetah has to run at a hidden speed between 0 and 2 m/s (the task of the MAML paper). A whole
meta-learning run, from the directory of the repository:

    pip install -e '.[gym]'
    export PYTHONPATH=examples
    maesn train maesn --family half_cheetah_velocity:family --run runs/cheetah \
        --normalize-observations True --outer.trust-region.damping 0.1
    maesn adapt runs/cheetah --family half_cheetah_velocity:family

Dense reward is minus the distance from the target speed, minus the environment's own control cost.
Sparse reward is the same within 0.3 m/s of the target speed, and a constant elsewhere.
"""

from typing import Any

import gymnasium
import mujoco
import numpy as np

from maesn.envs.foreign import gymnasium_family

MAX_SPEED = 2.0  # m/s, as in the MAML paper
SPARSE_RADIUS = 0.3  # m/s
HORIZON = 200  # steps of 0.05 s, as in the MAML paper


class TargetSpeed(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Rewards a target speed instead of a high one."""

    def __init__(self, env: gymnasium.Env[Any, Any], speed: float, reward: str) -> None:
        super().__init__(env)
        self.speed = speed
        self.sparse = reward == "sparse"

    def set_task(self, speed: np.ndarray) -> None:
        """Take another target speed, m/s. Without this method, each task gets a new environment."""
        self.speed = float(speed)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advance by one step of 0.05 s."""
        observation, _, terminated, truncated, info = self.env.step(action)
        distance = abs(info["x_velocity"] - self.speed)
        reached = bool(distance < SPARSE_RADIUS)
        closeness = -MAX_SPEED if self.sparse and not reached else -distance
        reward = float(closeness + info["reward_ctrl"])
        return observation, reward, terminated, truncated, {**info, "is_success": reached}


def make_env(speed: np.ndarray, reward: str) -> TargetSpeed:
    """Return the cheetah with a target speed in m/s, with the "dense" or "sparse" reward."""
    # MuJoCo 4 finds an attribute of Gymnasium's model deprecated, and says so of every cheetah.
    mujoco.set_mju_user_warning(lambda message: None)
    return TargetSpeed(gymnasium.make("HalfCheetah-v5"), float(speed), reward)


def draw_tasks(stream: np.random.Generator, size: int) -> np.ndarray:
    """Draw that many target speeds in m/s."""
    return stream.uniform(0.0, MAX_SPEED, size).astype(np.float32)


family = gymnasium_family(
    "half_cheetah_velocity",
    make_env,
    draw_tasks,
    task_names=("speed",),
    seed=20,
    horizon=HORIZON,
)
