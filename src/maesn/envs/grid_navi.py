"""GridNavi of VariBAD: a grid of cells, one of which is the goal.

Source: `GridNavi` of lmzintgraf/varibad (`environments/navigation/gridworld.py`, registered as
`GridNavi-v0` with 5 x 5 cells and 15 steps). There are 21 tasks, and every set is all of them: as
in the paper, new tasks are the old ones.

Observation (2 components; the goal is not among them): column and row, 0 to 4.

Action (one of 5): stay, up, right, down, left. A move against a wall leaves the agent where it is.

Every episode starts in cell (0, 0) and has 15 steps; the goal does not end it. The goal is any cell
but the start and the three cells next to it, one of them diagonally. The reward, dense and sparse,
is 1 if the agent is in the goal's cell after the step, else -0.1.

VariBAD plays four episodes as one long one: a trial of 60 steps. The control period is a name: a
step counts as a second.
"""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maesn.axes import Action, ActionKind, Readings
from maesn.envs.base import Reward, RewardKind, Variant
from maesn.envs.reaching import AbstractPoint, Goal
from maesn.envs.tasks import TaskFamily

CELLS = 5  # of a side
MOVES = ((0, 0), (0, 1), (1, 0), (0, -1), (-1, 0))  # stay, up, right, down, left
GOAL_REWARD, OTHER_REWARD = 1.0, -0.1


def goal_cells(cells: int = CELLS) -> np.ndarray:
    """Return all goals of a grid with that many cells a side, `[task, 2]`: columns and rows."""
    every = np.stack(np.meshgrid(*[np.arange(cells)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    return every[every.max(axis=1) > 1].astype(np.float32)


class GridNavi(AbstractPoint):
    """GridNavi of VariBAD: 5 x 5 cells, discrete actions, 21 tasks."""

    name: ClassVar[str] = "grid_navi"
    control_period: ClassVar[float] = 1.0
    action_kind: ClassVar[ActionKind] = "discrete"
    variants: ClassVar[tuple[str, ...]] = ("reference",)

    variant: Variant = "reference"
    reward_kind: RewardKind = "dense"
    sparse_radius: float = 0.5
    """In cells: the goal's cell and no other."""
    horizon: int = 15
    observation_size: int = 2
    action_size: int = len(MOVES)

    def control(self, action: Action) -> Float[Array, " action"]:
        return action

    def advance(self, readings: Readings, control: Float[Array, " control"]) -> Readings:
        here = readings["qpos"]
        there = jnp.clip(here + control @ jnp.asarray(MOVES, float), 0.0, CELLS - 1.0)
        return {"qpos": there, "qvel": there - here}

    def reward(
        self, readings: Readings, action: Action, next_readings: Readings, task: Goal
    ) -> Reward:
        there = self.solved(next_readings, task)
        return Reward(jnp.where(there, GOAL_REWARD, OTHER_REWARD), jnp.zeros(()))

    @property
    def uninformative_reward(self) -> float:
        return OTHER_REWARD

    def far_reward(self, task: Goal) -> Float[Array, ""]:
        return jnp.asarray(OTHER_REWARD)


def _first_goals(stream: np.random.Generator, size: int) -> np.ndarray:
    return goal_cells()[:size]


grid_navi = TaskFamily(
    "grid_navi", GridNavi, _first_goals, ("goal",), seed=21, num_tasks=len(goal_cells())
)
