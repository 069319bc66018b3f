"""A cart on a rail, on a user's own model: the simplest environment that MuJoCo moves.

With no damping and a time step h, MuJoCo's semi-implicit Euler method moves a cart of mass m under
a constant force f exactly by v_{t+1} = v_t + h f / m and x_{t+1} = x_t + h v_{t+1}.
"""

from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp

from maesn.axes import Key, Readings
from maesn.envs import AbstractMujocoEnv, Reward, RewardKind, Variant

TIME_STEP = 0.01
MOTOR = '<motor joint="rail"/>'
# The force is 900 times the speed, so each step multiplies the speed by 1 + 0.01 * 900 / 1 = 10.
RUNAWAY = '<general joint="rail" biastype="affine" gainprm="1" biasprm="0 0 900"/>'

MODEL = """
<mujoco>
  <option timestep="0.01" gravity="0 0 0"/>
  <worldbody>
    <body><joint name="rail" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body>
  </worldbody>
  <actuator>{actuator}</actuator>
</mujoco>
"""


class CartTask(NamedTuple):
    speed: Any
    """Of the start, in the episodes that `pushed` says; the others start at rest."""
    mass: Any


class Cart(AbstractMujocoEnv[CartTask]):
    """Driven by a constant force, whatever the agent does; rewards are the way of each step."""

    name: ClassVar[str] = "cart"
    readings: ClassVar[tuple[str, ...]] = ("qpos", "qvel")
    control_period: ClassVar[float] = TIME_STEP

    force: float = 0.0
    variant: Variant = "reference"
    sparse_radius: float = 0.0
    reward_kind: RewardKind = "dense"
    horizon: int = 12
    observation_size: int = 2
    action_size: int = 1

    def initial(self, key: Key, task: CartTask) -> tuple[jax.Array, jax.Array]:
        return jnp.zeros(1), jnp.where(pushed(key), task.speed, 0.0)[None]

    def control(self, action: jax.Array) -> jax.Array:
        return jnp.full(1, self.force)

    def observe(self, readings: Readings) -> jax.Array:
        return jnp.concatenate([readings["qpos"], readings["qvel"]])

    def reward(
        self, readings: Readings, action: jax.Array, next_readings: Readings, task: CartTask
    ) -> Reward:
        return Reward(next_readings["qpos"][0] - readings["qpos"][0], jnp.zeros(()))

    def solved(self, readings: Readings, task: CartTask) -> jax.Array:
        return jnp.zeros((), bool)

    def position(self, observation: jax.Array) -> jax.Array:
        return jnp.stack([observation[0], jnp.zeros(())])

    def goal(self, task: CartTask) -> jax.Array:
        return jnp.zeros(2)

    def model_fields(self, task: CartTask) -> dict[str, jax.Array]:
        return {"body_mass": jnp.stack([jnp.zeros(()), task.mass])}


def pushed(key: Key) -> jax.Array:
    """Whether the episode that starts with this key is pushed: half of them are."""
    return jax.random.bernoulli(key)


def cart_on(directory: Path, actuator: str) -> type[Cart]:
    """The cart with that actuator, on a model file that is written to the directory."""
    path = directory / "cart.xml"
    path.write_text(MODEL.format(actuator=actuator), encoding="utf-8")

    class CartOnFile(Cart):
        model: ClassVar[str] = str(path)

    return CartOnFile
