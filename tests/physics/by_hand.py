"""What the robots' environments must make of MuJoCo's quantities, written down once more in NumPy.

The variant is `reference`, the reward sparse. Quantities have the axes `[time_plus_1, ...]`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

HOMES = np.stack([0.2 * np.arange(1, 6), np.zeros(5)], axis=-1)


class Judged(NamedTuple):
    observation: np.ndarray
    """`[time_plus_1, observation]`"""
    goal_reward: np.ndarray
    """`[time]`"""
    cost: np.ndarray
    """What is taken off it, `[time]`."""
    solved: np.ndarray
    """`[time]`"""
    ends: np.ndarray
    """Whether a state ends the episode, `[time_plus_1]`."""


def wheeled(read: Any, control: np.ndarray, goal: np.ndarray, radius: float) -> Judged:
    distance = np.linalg.norm(read["qpos"][1:, :2] - goal, axis=-1)
    return Judged(
        np.concatenate([read["qpos"], read["qvel"]], axis=-1),
        np.where(distance > radius, -np.linalg.norm(goal), -distance),
        0.05 * (control**2).sum(-1),
        distance <= radius,
        np.zeros(len(read["qpos"]), bool),
    )


def ant(read: Any, control: np.ndarray, goal: np.ndarray, radius: float) -> Judged:
    centre, height = read["subtree_com"][:, 1], read["qpos"][:, 2]
    forces = np.clip(read["cfrc_ext"][:, :14], -1, 1).reshape(-1, 84)
    way = centre[1:, :2] - goal
    near = np.linalg.norm(way, axis=-1) <= radius
    return Judged(
        np.concatenate([read["qpos"], read["qvel"], forces, read["xmat"][:, 1], centre], axis=-1),
        4 - np.where(near, np.abs(way).sum(-1), np.abs(goal).sum()),
        0.005 * (control**2).sum(-1) + 0.0005 * (forces[1:] ** 2).sum(-1) - 0.05,
        near,
        (height < 0.2) | (height > 1.0),
    )


def blockpush(read: Any, control: np.ndarray, task: Any, radius: float) -> Judged:
    blocks = read["qpos"][:, 3:].reshape(-1, 5, 2) + HOMES
    distance = np.linalg.norm(blocks[1:, task.block] - task.goal, axis=-1)
    seen = [read["qpos"][:, :3], blocks.reshape(-1, 10), read["qvel"]]
    return Judged(
        np.concatenate(seen, axis=-1),
        -5 * np.where(distance > radius, np.linalg.norm(task.goal), distance),
        np.zeros(len(control)),
        distance <= radius,
        np.zeros(len(read["qpos"]), bool),
    )


class Robot(NamedTuple):
    judge: Callable[..., Judged]
    """What is read, controls, task, radius of the goal region -> what the environment must say."""
    scale: float
    """Of the actions; the range of the actuators is as large."""
    read: tuple[str, ...] = ("qpos", "qvel")
    """What is read."""


ROBOTS = {
    "wheeled": Robot(wheeled, 2.0),
    "ant": Robot(ant, 1.0, ("qpos", "qvel", "cfrc_ext", "subtree_com", "xmat")),
    "blockpush": Robot(blockpush, 2.0),
}
