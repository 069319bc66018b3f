"""The sparse point robot of PEARL, VariBAD and MetaCURE: a point that must find its goal.

Sources: `SparsePointEnv` of katerakelly/oyster (`rlkit/envs/point_robot.py`), of lmzintgraf/varibad
(`environments/navigation/point_robot.py`, before its fork with other goals) and of
NagisaZj/MetaCURE-Public (`rlkit/envs/point_robot.py`). `docs/reference/families.md` says in which
numbers they differ. `reference` means `pearl`. The variant does not choose the reward.

Observation (2 components; the goal is not among them): position x, y.

Action (2 components a, unbounded): step in x and y, 0.1 u with u = clip(a, -1, 1).

Every episode starts at the origin and has T steps; nothing ends it early. Goals lie on the upper
half of the unit circle. With d the distance from the goal after the step, the reward is

    dense:   -d
    sparse:  1 - d where d <= R, else 0

Differences from the sources: the sets have 100 tasks each, with uniform angles, as VariBAD draws
them; the others have an even grid of angles that is shuffled, so that most of PEARL's test goals
lie 0.03 from a training goal (`grid_goals` returns them). The control period is a name: a step
counts as a second.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maesn.axes import Action, Readings
from maesn.envs.base import Reward, RewardKind, Variant
from maesn.envs.goals import half_circle_family
from maesn.envs.reaching import AbstractPoint, Goal

GOAL_RADIUS = 1.0
STEP_LENGTH = 0.1  # of each coordinate, for a control of 1

PROTOCOLS: dict[str, dict[str, Any]] = {
    "pearl": {"sparse_radius": 0.2, "horizon": 20},
    "varibad": {"sparse_radius": 0.2, "horizon": 100},
    "metacure": {"sparse_radius": 0.3, "horizon": 32},
}
"""Variant -> the settings that it has."""


class SparsePoint(AbstractPoint):
    """The sparse point robot of PEARL, VariBAD and MetaCURE; `make_sparse_point` makes them."""

    name: ClassVar[str] = "sparse_point"
    control_period: ClassVar[float] = 1.0
    variants: ClassVar[tuple[str, ...]] = tuple(PROTOCOLS)

    variant: Variant = "pearl"
    reward_kind: RewardKind = "dense"
    sparse_radius: float = 0.2
    horizon: int = 20
    observation_size: int = 2
    action_size: int = 2

    def control(self, action: Action) -> Float[Array, " 2"]:
        return jnp.clip(action, -1.0, 1.0)

    def advance(self, readings: Readings, control: Float[Array, " control"]) -> Readings:
        step = STEP_LENGTH * control
        return {"qpos": readings["qpos"] + step, "qvel": step / self.control_period}

    def reward(
        self, readings: Readings, action: Action, next_readings: Readings, task: Goal
    ) -> Reward:
        distance = self.distance(next_readings, task)
        near = jnp.where(distance <= self.sparse_radius, 1.0 - distance, 0.0)
        return Reward(-distance if self.reward_kind == "dense" else near, jnp.zeros(()))

    def far_reward(self, task: Goal) -> Float[Array, ""]:
        return jnp.zeros(())


def make_sparse_point(variant: Variant = "reference", **settings: Any) -> SparsePoint:
    """The sparse point robot of PEARL, VariBAD and MetaCURE.

    The variant is `pearl`, which `reference` means as well, `varibad` or `metacure`; settings are
    fields that are not to be as it has them. Either may be a ValueError.
    """
    name: Variant = "pearl" if variant == "reference" else variant
    return SparsePoint(variant=name, **(PROTOCOLS.get(name, {}) | settings))


def grid_goals(size: int) -> np.ndarray:
    """Return the goals of the code of PEARL and MetaCURE, `[size, 2]`, in its order.

    PEARL has 100 of them and trains on the first 80, MetaCURE 60 and trains on the first 40; both
    test on the last 20.
    """
    angle = np.linspace(0.0, np.pi, size)
    goals = GOAL_RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    np.random.RandomState(1337).shuffle(goals)  # the stream of their code
    return goals.astype(np.float32)


sparse_point = half_circle_family("sparse_point", make_sparse_point, GOAL_RADIUS, seed=1337)
