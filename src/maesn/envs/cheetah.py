"""Gymnasium's half cheetah that is to run at a speed, in a direction, or with another body.

`docs/reference/families.md` has tasks, rewards, and what differs from their sources:
`HalfCheetahVelEnv` and `HalfCheetahDirEnv` of katerakelly/oyster (`rlkit/envs`), which
lmzintgraf/varibad and jonasrothfuss/ProMP have with the same numbers; `HalfCheetahBodyEnv` of
ido90/RobustMetaRL (RoML). An episode has 200 steps of 0.05 s and never ends early.

Observation (17 components, of Gymnasium's `HalfCheetah-v5`; the task is not among them):

| index | quantity                                                            | unit       |
|-------|---------------------------------------------------------------------|------------|
| 0-1   | height and pitch of the torso                                       | m, rad     |
| 2-7   | angles of the back thigh, shin, foot, the front thigh, shin, foot   | rad        |
| 8-10  | velocity x, z and rate of pitch of the torso                        | m/s, rad/s |
| 11-16 | speeds of the six joints                                            | rad/s      |

Action (6 components a, unbounded; the motors receive u = clip(a, -1, 1)): torque on the joints, in
the order of the angles, 120, 90, 60, 120, 60, 30 N m for a unit.
"""

from functools import cache
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maesn.axes import Readings
from maesn.envs.base import RewardKind, Task, Variant
from maesn.envs.tasks import TaskFamily
from maesn.envs.walking import HORIZON, AbstractPlaceless
from maesn.physics import field_values, load_model

LARGEST_SPEED = 3.0  # m/s, of the targets; oyster
LARGEST_FACTOR = 2.0  # of mass, damping and friction, and the inverse of the smallest; RoML


class AbstractCheetah(AbstractPlaceless[Task]):
    """The half cheetah, its motors and what it observes."""

    model: ClassVar[str] = "gymnasium_half_cheetah"
    readings: ClassVar[tuple[str, ...]] = ("qpos", "qvel")
    standing: ClassVar[tuple[float, ...]] = (0.0,) * 9
    num_speeds: ClassVar[int] = 9
    control_cost: ClassVar[float] = 0.05

    variant: Variant = "reference"
    reward_kind: RewardKind = "dense"
    """Without effect: the sources have one reward each."""
    sparse_radius: float = 0.0
    """Without effect: there is no goal region."""
    horizon: int = HORIZON
    observation_size: int = 17
    action_size: int = 6

    def observe(self, readings: Readings) -> Float[Array, " 17"]:
        return jnp.concatenate([readings["qpos"][1:], readings["qvel"]])


class CheetahVel(AbstractCheetah[Float[Array, ""]]):
    """Gymnasium's half cheetah at a hidden target speed; the task is v* in m/s."""

    name: ClassVar[str] = "cheetah_vel"

    def goal_reward(
        self, readings: Readings, next_readings: Readings, task: Float[Array, ""]
    ) -> Float[Array, ""]:
        return -jnp.abs(self.velocity(readings, next_readings)[0] - task)


class CheetahDir(AbstractCheetah[Float[Array, ""]]):
    """Gymnasium's half cheetah in a hidden direction; the task is -1 or 1."""

    name: ClassVar[str] = "cheetah_dir"

    def goal_reward(
        self, readings: Readings, next_readings: Readings, task: Float[Array, ""]
    ) -> Float[Array, ""]:
        return task * self.velocity(readings, next_readings)[0]


class Body(NamedTuple):
    """What multiplies numbers of the model."""

    mass: Float[Array | np.ndarray, "*row"]
    """Of all masses and moments of inertia."""
    damping: Float[Array | np.ndarray, "*row"]
    """Of all joints."""
    friction: Float[Array | np.ndarray, "*row"]
    """Of all contacts: sliding, spinning and rolling."""


class CheetahBody(AbstractCheetah[Body]):
    """Gymnasium's half cheetah with a hidden body; the task is a `Body`."""

    name: ClassVar[str] = "cheetah_body"

    def goal_reward(
        self, readings: Readings, next_readings: Readings, task: Body
    ) -> Float[Array, ""]:
        return self.velocity(readings, next_readings)[0] + next_readings["qpos"][1]

    def model_fields(self, task: Body) -> dict[str, Array]:
        factors = {
            "body_mass": task.mass,
            "body_inertia": task.mass,
            "dof_damping": task.damping,
            "geom_friction": task.friction,
        }
        own = _own_fields(self.model, tuple(factors))
        return {name: jnp.asarray(factor) * own[name] for name, factor in factors.items()}

    def situation(self, task: Body) -> Any:
        """Return the body: episodes depend on all of it."""
        return task


@cache
def _own_fields(model: str, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    return field_values(load_model(model), names)


def drawn_velocities(size: int) -> np.ndarray:
    """Return the target speeds of oyster's own code, `[size]` in m/s; 130 in its `cheetah-vel`."""
    return np.random.RandomState(1337).uniform(0.0, LARGEST_SPEED, size).astype(np.float32)


def _draw_speeds(stream: np.random.Generator, size: int) -> np.ndarray:
    return stream.uniform(0.0, LARGEST_SPEED, size).astype(np.float32)


def _first_directions(stream: np.random.Generator, size: int) -> np.ndarray:
    return np.array([-1.0, 1.0], np.float32)[:size]


def _draw_bodies(stream: np.random.Generator, size: int) -> Body:
    drawn = LARGEST_FACTOR ** stream.uniform(-1.0, 1.0, (3, size))
    return Body(*drawn.astype(np.float32))


def _check_bodies(bodies: Body) -> None:
    """Raise ValueError for factors that are not positive."""
    for name, factors in bodies._asdict().items():
        wrong = np.flatnonzero(factors <= 0)
        if wrong.size:
            raise ValueError(
                f"`{name}` must be positive, got {factors[wrong[0]]} in row {wrong[0]}"
            )


cheetah_vel = TaskFamily("cheetah_vel", CheetahVel, _draw_speeds, ("velocity",), seed=1703)
cheetah_dir = TaskFamily(
    "cheetah_dir", CheetahDir, _first_directions, ("direction",), seed=1803, num_tasks=2
)
cheetah_body = TaskFamily(
    "cheetah_body", CheetahBody, _draw_bodies, Body._fields, seed=2301, check_tasks=_check_bodies
)
