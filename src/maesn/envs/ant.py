"""A four-legged robot that walks to a hidden goal (section "Legged Locomotion").

Observation (125 components; the goal is not among them):

| index   | quantity                                                             | unit       |
|---------|----------------------------------------------------------------------|------------|
| 0-2     | position x, y, z of the torso                                        | m          |
| 3-6     | orientation of the torso, quaternion w, x, y, z                      |            |
| 7-14    | angles of hip 1, ankle 1, ..., hip 4, ankle 4                        | rad        |
| 15-17   | velocity x, y, z of the torso                                        | m/s        |
| 18-20   | rate of turn of the torso about its own axes                         | rad/s      |
| 21-28   | speeds of hip 1, ankle 1, ..., hip 4, ankle 4                        | rad/s      |
| 29-112  | contact torque x, y, z and force x, y, z on each of 14 bodies (the   | N m, N     |
|         | world, the torso, three segments of legs 1 to 4), clipped to [-1, 1] |            |
| 113-121 | rotation matrix of the torso, row by row                             |            |
| 122-124 | centre of mass x, y, z of the whole ant                              | m          |

Action (8 components a, unbounded; the motors receive u = clip(a, -1, 1)). The order is not that of
the angles:

| index | control u                   | unit and range      |
|-------|-----------------------------|---------------------|
| 0-1   | torque on hip 4 and ankle 4 | 30 N m, -1 to 1     |
| 2-3   | torque on hip 1 and ankle 1 | 30 N m, -1 to 1     |
| 4-5   | torque on hip 2 and ankle 2 | 30 N m, -1 to 1     |
| 6-7   | torque on hip 3 and ankle 3 | 30 N m, -1 to 1     |

Reward, with x the horizontal centre of mass, g the goal, R the sparse radius, and c the clipped
contact torques and forces:

| variant     | dense                | sparse, where |x - g|_2 > R |
|-------------|----------------------|-----------------------------|
| `reference` | 4 - |x - g|_1 - cost | 4 - |g|_1 - cost            |
| `paper`     | -|x - g|_2           | 4 - c_max                   |

    cost = 0.005 sum(u^2) + 0.0005 sum(c^2) - 0.05

Inside of R the sparse reward is the reference's dense one, or the paper's 4 - |x - g|_2: the paper
prints the 4 in the sparse reward alone.

Episodes last 200 steps of 0.01 s. A state that is not finite ends them. In the reference variant,
so does a torso below 0.2 m or above 1 m; its dense reward is positive, so that falling costs. The
paper does not speak of an end, and with its negative dense reward an early end would be a gain.
"""

from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.axes import Action, Key, Readings
from maesn.envs.base import AbstractMujocoEnv, Reward, RewardKind, Variant
from maesn.envs.goals import half_circle_family
from maesn.envs.reaching import GOAL_RADIUS, AbstractReaching, Goal

SPARSE_RADIUS = 0.8  # metres; appendix "Reward Functions"
# Appendix "Reward Functions" (sparse reward alone); the reference adds it to the dense one, too.
BONUS = 4.0
# The paper calls it "an uninformative large negative constant": the distance of an ant that has not
# moved.
C_MAX = GOAL_RADIUS
CONTROL_COST = 0.005  # reference, per squared unit of control
CONTACT_COST = 0.0005  # reference, per squared newton or newton metre, after clipping
SURVIVAL_BONUS = 0.05  # reference, per step
CONTACT_CLIP = 1.0  # reference, newtons and newton metres
HEIGHTS = (0.2, 1.0)  # metres; the reference ends an episode outside
POSITION_NOISE = 0.01  # standard deviation of the start, reference
VELOCITY_NOISE = 0.1

# Standing, from the reference: x, y, z, quaternion, and the joints, with ankles bent by 1 rad.
START = (0.0, 0.0, 0.55, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0)
TORSO = 1  # index of the body
NUM_BODIES = 14  # the world and the ant's 13 parts; the marker of the goal comes after them
LARGEST = 1e10  # MuJoCo calls larger numbers bad, and goes on without them


class Ant(AbstractReaching, AbstractMujocoEnv[Goal]):
    """A four-legged robot that walks to a hidden goal on a half circle."""

    name: ClassVar[str] = "ant"
    model: ClassVar[str] = "ant.xml"
    readings: ClassVar[tuple[str, ...]] = ("qpos", "qvel", "cfrc_ext", "subtree_com")
    nonfinite: ClassVar[Literal["raise", "report"]] = "report"
    control_period: ClassVar[float] = 0.01

    variant: Variant = "reference"
    reward_kind: RewardKind = "dense"
    sparse_radius: float = SPARSE_RADIUS
    horizon: int = 200
    observation_size: int = 125
    action_size: int = 8

    def initial(self, key: Key, task: Goal) -> tuple[Float[Array, " 15"], Float[Array, " 14"]]:
        position_key, velocity_key = jax.random.split(key)
        qpos = jnp.asarray(START) + POSITION_NOISE * jax.random.normal(position_key, (15,))
        return qpos, VELOCITY_NOISE * jax.random.normal(velocity_key, (14,))

    def control(self, action: Action) -> Float[Array, " 8"]:
        return jnp.clip(action, -1.0, 1.0)

    def observe(self, readings: Readings) -> Float[Array, " 125"]:
        return jnp.concatenate(
            [
                readings["qpos"],
                readings["qvel"],
                contact_forces(readings).ravel(),
                rotation_matrix(readings["qpos"][3:7]).ravel(),
                readings["subtree_com"][TORSO],
            ]
        )

    def reward(
        self, readings: Readings, action: Action, next_readings: Readings, task: Goal
    ) -> Reward:
        seen = last_sound(readings, next_readings)
        goal = self._goal_reward(seen, task)
        if self.variant == "paper":
            return Reward(goal, jnp.zeros(()))
        control_cost = CONTROL_COST * jnp.sum(self.control(action) ** 2)
        contact_cost = CONTACT_COST * jnp.sum(contact_forces(seen) ** 2)
        return Reward(goal, SURVIVAL_BONUS - control_cost - contact_cost)

    def _goal_reward(self, readings: Readings, goal: Goal) -> Float[Array, ""]:
        way = readings["subtree_com"][TORSO, :2] - goal
        if self.variant == "paper":
            distance, dense_bonus = jnp.linalg.norm(way), 0.0
        else:
            distance, dense_bonus = jnp.abs(way).sum(), BONUS
        if self.reward_kind == "dense":
            return dense_bonus - distance
        near = self.solved(readings, goal)
        return jnp.where(near, BONUS - distance, self.far_reward(goal))

    def far_reward(self, task: Goal) -> Float[Array, ""]:
        far = C_MAX if self.variant == "paper" else jnp.abs(task).sum()
        return jnp.asarray(BONUS - far)

    @property
    def uninformative_reward(self) -> float:
        return BONUS - C_MAX

    def terminated(self, readings: Readings) -> Bool[Array, ""]:
        lost = jnp.logical_not(is_sound(readings))
        if self.variant == "paper":
            return lost
        height = readings["qpos"][2]
        return lost | (height < HEIGHTS[0]) | (height > HEIGHTS[1])

    def position(self, observation: Float[Array, " observation"]) -> Float[Array, " 2"]:
        return observation[122:124]


def rotation_matrix(quaternion: Float[Array, " 4"]) -> Float[Array, "3 3"]:
    """Return the matrix that turns a body's own axes into the world's.

    R = 2 (w^2 - 1/2) I + 2 v v^T + 2 w [v]_x for the unit quaternion (w, v). The starts of episodes
    are not of unit length, so the quaternion is normalised first, as MuJoCo does.
    """
    w, x, y, z = quaternion / jnp.linalg.norm(quaternion)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row) for row in rows])


def contact_forces(readings: Readings) -> Float[Array, "14 6"]:
    """Return the clipped contact torques and forces on the world and on each part of the ant."""
    return jnp.clip(readings["cfrc_ext"][:NUM_BODIES], -CONTACT_CLIP, CONTACT_CLIP)


def is_sound(readings: Readings) -> Bool[Array, ""]:
    """Whether the state is finite and of a size that the engine can go on from."""
    state = jnp.concatenate([readings["qpos"], readings["qvel"]])
    return jnp.all(jnp.abs(state) <= LARGEST)  # false of NaN as well


def last_sound(readings: Readings, next_readings: Readings) -> Readings:
    """Return the state after a step, or the one before if it blew up: that has no reward."""
    alive = is_sound(next_readings)
    return jax.tree.map(lambda new, old: jnp.where(alive, new, old), next_readings, readings)


ant = half_circle_family("ant", Ant, GOAL_RADIUS, seed=2019)
