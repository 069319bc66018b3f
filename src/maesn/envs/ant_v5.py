"""Gymnasium's ant that is to walk in a direction or to a goal.

It is another ant than that of the MAESN paper (`maesn.envs.ant`): stronger, with steps five times
as long. `docs/reference/families.md` has tasks, rewards, ends and their sources.

Observation (107 components; `ant_dir` lacks the first two; the task is not among them):

| index  | quantity                                                              | unit       |
|--------|-----------------------------------------------------------------------|------------|
| 0-1    | position x, y of the torso                                            | m          |
| 2-6    | height of the torso, its orientation as a quaternion w, x, y, z       | m          |
| 7-14   | angles of hip 1, ankle 1, ..., hip 4, ankle 4                         | rad        |
| 15-20  | velocity x, y, z of the torso, rates of turn about its own axes       | m/s, rad/s |
| 21-28  | speeds of hip 1, ankle 1, ..., hip 4, ankle 4                         | rad/s      |
| 29-106 | contact torque x, y, z and force x, y, z on each of the 13 bodies,    | N m, N     |
|        | clipped to [-1, 1]                                                    |            |

Action (8 components a, unbounded; the motors receive u = clip(a, -1, 1), 150 N m for a unit): hip
4, ankle 4, hip 1, ankle 1, hip 2, ankle 2, hip 3, ankle 3.

Differences from the sources (`AntRandDirec2DEnv` and `AntRandGoalEnv` of jonasrothfuss/ProMP,
`AntDirEnv` and `AntGoalEnv` of katerakelly/oyster, `AntGoalSparseEnv` of lmzintgraf/hyperx):
observations are those of Gymnasium's `Ant-v5`, and with positions for goals. Oyster shows contact
forces for goals alone (27 and 113 components, the forces on the world among them), hyperx the
position of the torso once more (116). Here contact forces and the velocity belong to the state that
the step leads to. ProMP has no lower limit of the torso. A state that is not finite ends an
episode; the sources' engine silently reset such a state.
"""

from typing import ClassVar, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from maesn.axes import Action, Readings
from maesn.envs.ant import CONTACT_COST, HEIGHTS, contact_forces, is_sound, last_sound
from maesn.envs.base import Reward, RewardKind, Task, Variant
from maesn.envs.reaching import AbstractReaching, Goal
from maesn.envs.tasks import TaskFamily
from maesn.envs.walking import HORIZON, AbstractPlaceless, AbstractWalking

SURVIVAL_BONUS = 1.0  # per step, in `ant_dir`; oyster
LARGEST_DISTANCE = 3.0  # metres, of goals from the start; ProMP
GOAL_RADIUS = 0.75  # metres; hyperx


class AbstractAntV5(AbstractWalking[Task]):
    """Gymnasium's ant and its motors."""

    model: ClassVar[str] = "gymnasium_ant"
    readings: ClassVar[tuple[str, ...]] = ("qpos", "qvel", "cfrc_ext")
    nonfinite: ClassVar[Literal["raise", "report"]] = "report"
    standing: ClassVar[tuple[float, ...]] = (0.0, 0.0, 0.75, 1.0, *(0.0,) * 11)
    num_speeds: ClassVar[int] = 14

    variant: Variant = "reference"
    reward_kind: RewardKind = "dense"
    """Without effect: the sources have one reward each."""
    sparse_radius: float = GOAL_RADIUS
    """In metres, where a goal counts as reached."""
    horizon: int = HORIZON
    observation_size: int = 107
    action_size: int = 8

    def observe(self, readings: Readings) -> Float[Array, " 107"]:
        forces = contact_forces(readings)[1:]  # the world's are not shown
        return jnp.concatenate([readings["qpos"], readings["qvel"], forces.ravel()])

    def terminated(self, readings: Readings) -> Bool[Array, ""]:
        return jnp.logical_not(is_sound(readings))

    def reward(
        self, readings: Readings, action: Action, next_readings: Readings, task: Task
    ) -> Reward:
        """Return the reward of a step; if the state blew up, that of the last sound one."""
        return super().reward(readings, action, last_sound(readings, next_readings), task)

    def costs(self, readings: Readings, action: Action) -> Float[Array, ""]:
        """Return the cost of controls and contacts."""
        contact_cost = CONTACT_COST * jnp.sum(contact_forces(readings) ** 2)
        return super().costs(readings, action) + contact_cost


class AntDir(AbstractAntV5[Goal], AbstractPlaceless[Goal]):
    """Gymnasium's ant in a hidden direction; the task is a unit vector."""

    name: ClassVar[str] = "ant_dir"
    control_cost: ClassVar[float] = 0.5

    observation_size: int = 105

    def observe(self, readings: Readings) -> Float[Array, " 105"]:
        return super().observe(readings)[2:]

    def goal_reward(
        self, readings: Readings, next_readings: Readings, task: Goal
    ) -> Float[Array, ""]:
        return jnp.dot(self.velocity(readings, next_readings), task)

    def costs(self, readings: Readings, action: Action) -> Float[Array, ""]:
        return super().costs(readings, action) - SURVIVAL_BONUS

    def terminated(self, readings: Readings) -> Bool[Array, ""]:
        height = readings["qpos"][2]
        fallen = (height < HEIGHTS[0]) | (height > HEIGHTS[1])
        return super().terminated(readings) | fallen


class AntGoal(AbstractAntV5[Goal], AbstractReaching):
    """Gymnasium's ant that walks to a hidden goal."""

    name: ClassVar[str] = "ant_goal"
    control_cost: ClassVar[float] = 0.1

    def goal_reward(
        self, readings: Readings, next_readings: Readings, task: Goal
    ) -> Float[Array, ""]:
        return -jnp.abs(next_readings["qpos"][:2] - task).sum()

    def position(self, observation: Float[Array, " observation"]) -> Float[Array, " 2"]:
        return observation[:2]


class SparseAntGoal(AntGoal):
    """Gymnasium's ant that is rewarded near its hidden goal alone."""

    name: ClassVar[str] = "sparse_ant_goal"
    control_cost: ClassVar[float] = 0.01

    def goal_reward(
        self, readings: Readings, next_readings: Readings, task: Goal
    ) -> Float[Array, ""]:
        distance, there = self.distance(next_readings, task), self.solved(next_readings, task)
        return jnp.where(there, 1.0 - distance, self.far_reward(task))

    def far_reward(self, task: Goal) -> Float[Array, ""]:
        return jnp.asarray(-self.sparse_radius)


def _on_circle(angle: np.ndarray, radius: float | np.ndarray) -> np.ndarray:
    return (radius * np.stack([np.cos(angle), np.sin(angle)])).T.astype(np.float32)


def _draw_directions(stream: np.random.Generator, size: int) -> np.ndarray:
    return _on_circle(stream.uniform(0.0, 2 * np.pi, size), 1.0)


def _draw_goals(stream: np.random.Generator, size: int) -> np.ndarray:
    angle, share = stream.uniform(0.0, 2 * np.pi, size), stream.uniform(0.0, 1.0, size)
    return _on_circle(angle, LARGEST_DISTANCE * np.sqrt(share))  # uniform on the disc


ant_dir = TaskFamily("ant_dir", AntDir, _draw_directions, ("direction",), seed=1906)
ant_goal = TaskFamily("ant_goal", AntGoal, _draw_goals, ("goal",), seed=1810)
sparse_ant_goal = TaskFamily("sparse_ant_goal", SparseAntGoal, _draw_goals, ("goal",), seed=2010)
