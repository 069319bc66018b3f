"""A family of your own in JAX, with discrete actions: Bernoulli bandits.

    export PYTHONPATH=examples
    maesn train rl2 --family bernoulli_bandit:bandit --run runs/bandit
    maesn adapt runs/bandit --family bernoulli_bandit:bandit --reward dense

They are those of Duan et al. (2016, section 3.1, https://arxiv.org/abs/1611.02779): an arm's reward
is 1 with a probability of its own, else 0. The Bayes optimal return over all tasks, with uniform
probabilities, is 6.66 of 10; `benchmarks/bandit.py` computes it, and how near RL2 comes to it.
"""

from typing import ClassVar, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from maesn.axes import Action, ActionKind, Key, Readings
from maesn.envs import AbstractPureEnv, Reward, RewardKind, TaskFamily, Variant

Probabilities: TypeAlias = Float[Array, " arm"]

ARMS, PULLS = 5, 10  # the smallest of the bandits of Duan et al.


class Bandit(AbstractPureEnv[Probabilities]):
    """Arms with a reward of 1 with an unknown probability each; the agent sees nothing else.

    Action (one of `action_size` arms): which one to pull. Observation (1): always 0. Reward, dense
    and sparse: 1 or 0. An episode has T pulls. A step is "solved" if its reward is 1.

    State: `qpos` holds the number of pulls so far and the draws u_t ~ U(0, 1) of all pulls, `qvel`
    the arm that was pulled last (one-hot). Arm k is rewarded at pull t if u_t < p_k.
    """

    name: ClassVar[str] = "bandit"
    control_period: ClassVar[float] = 1.0  # a pull counts as one second
    action_kind: ClassVar[ActionKind] = "discrete"
    planar: ClassVar[bool] = False

    variant: Variant = "reference"
    reward_kind: RewardKind = "dense"
    sparse_radius: float = 0.0
    horizon: int = PULLS
    observation_size: int = 1
    action_size: int = ARMS

    def initial(self, key: Key, task: Probabilities) -> tuple[Array, Array]:
        draws = jax.random.uniform(key, (self.horizon,))
        return jnp.append(0.0, draws), jnp.zeros(self.action_size)

    def control(self, action: Float[Array, " action"]) -> Float[Array, " action"]:
        return action

    def advance(self, readings: Readings, control: Float[Array, " control"]) -> Readings:
        return {"qpos": readings["qpos"].at[0].add(1.0), "qvel": control}

    def observe(self, readings: Readings) -> Float[Array, " 1"]:
        return jnp.zeros(1)

    def reward(
        self, readings: Readings, action: Action, next_readings: Readings, task: Probabilities
    ) -> Reward:
        rewarded = self.solved(next_readings, task).astype(action.dtype)
        return Reward(rewarded, jnp.zeros(()))

    def solved(self, readings: Readings, task: Probabilities) -> Bool[Array, ""]:
        # Before the first pull no arm is pulled, and the probability below is 0.
        pulls, draws = readings["qpos"][0].astype(int), readings["qpos"][1:]
        return draws[jnp.maximum(pulls - 1, 0)] < readings["qvel"] @ task

    def position(self, observation: Float[Array, " observation"]) -> Float[Array, " 2"]:
        """Return the origin: a bandit has no position."""
        return jnp.zeros(2)

    def goal(self, task: Probabilities) -> Float[Array, " 2"]:
        """Return the origin: a bandit has no position."""
        return jnp.zeros(2)


def _draw_probabilities(stream: np.random.Generator, size: int) -> np.ndarray:
    return stream.uniform(0.0, 1.0, (size, ARMS)).astype(np.float32)


bandit = TaskFamily("bandit", Bandit, _draw_probabilities, ("probabilities",), seed=35)
