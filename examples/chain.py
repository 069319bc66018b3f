"""A family of your own in JAX that needs exploration: a corridor with a reward at its far end.

    export PYTHONPATH=examples
    maesn train maesn --family chain:chain --run runs/chain
    maesn compare runs/chain --family chain:chain --scratch trpo vime

The best return is 30/g with dense rewards, and 51 - g in whole steps with sparse ones, g being the
task. `benchmarks/vime_chain.py` shows who finds the sparse reward at all.
"""

from typing import ClassVar, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from maesn.axes import Action, Key, Readings
from maesn.envs import AbstractPureEnv, Reward, RewardKind, TaskFamily, Variant

Distance: TypeAlias = Float[Array, ""]

LENGTH = 30.0  # full steps from one end to the other
NEAREST = 28.0  # where the reward begins at the nearest


class Chain(AbstractPureEnv[Distance]):
    """A corridor between two walls, rewarded at its far end: 30 steps of 50 must go that way.

    Observation (1): position, as a share of the length. Action (1): the step, clipped to [-1, 1];
    the agent starts at 0, and walls stand there and at 30. With x_t its position and g the task,
    28 to 30:

        dense:   r_t = (x_{t+1} - x_t) / g                          the return is x_T / g
        sparse:  r_t = 1 where x_{t+1} >= g - sparse_radius, else `reward_elsewhere`

    Steps drawn from N(0, 1) reach about 12 in an episode, so that chance hardly ever finds a
    reward: the sparse chain is for agents that explore on purpose. (Houthooft et al. 2016 use
    sparse mountain car for this.)
    """

    name: ClassVar[str] = "chain"
    control_period: ClassVar[float] = 1.0  # a step counts as one second

    variant: Variant = "reference"
    reward_kind: RewardKind = "dense"
    sparse_radius: float = 0.0
    reward_elsewhere: float = 0.0
    """Sparse reward of the other steps, the same everywhere."""
    horizon: int = 50
    observation_size: int = 1
    action_size: int = 1

    def initial(self, key: Key, task: Distance) -> tuple[Float[Array, " 1"], Float[Array, " 1"]]:
        return jnp.zeros(1), jnp.zeros(1)

    def control(self, action: Float[Array, " action"]) -> Float[Array, " 1"]:
        return jnp.clip(action, -1.0, 1.0)

    def advance(self, readings: Readings, control: Float[Array, " control"]) -> Readings:
        position = jnp.clip(readings["qpos"] + control, 0.0, LENGTH)
        return {"qpos": position, "qvel": readings["qvel"]}

    def observe(self, readings: Readings) -> Float[Array, " 1"]:
        return readings["qpos"] / LENGTH

    def reward(
        self, readings: Readings, action: Action, next_readings: Readings, task: Distance
    ) -> Reward:
        step = (next_readings["qpos"][0] - readings["qpos"][0]) / task
        sparse = jnp.where(self.solved(next_readings, task), 1.0, self.reward_elsewhere)
        return Reward(step if self.reward_kind == "dense" else sparse, jnp.zeros(()))

    def solved(self, readings: Readings, task: Distance) -> Bool[Array, ""]:
        return readings["qpos"][0] >= task - self.sparse_radius

    @property
    def uninformative_reward(self) -> float:
        return self.reward_elsewhere

    def position(self, observation: Float[Array, " observation"]) -> Float[Array, " 2"]:
        return jnp.append(LENGTH * observation, 0.0)

    def goal(self, task: Distance) -> Float[Array, " 2"]:
        return jnp.stack([task, jnp.zeros(())])


def _draw_distances(stream: np.random.Generator, size: int) -> np.ndarray:
    return stream.uniform(NEAREST, LENGTH, size).astype(np.float32)


chain = TaskFamily("chain", Chain, _draw_distances, ("distance",), seed=36)
