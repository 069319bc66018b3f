"""The policy of soft actor-critic: a squashed Gaussian whose spread depends on the observation."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import ObservedReward, RecurrentState
from maesn.networks import MLP
from maesn.numerics import SquashedGaussian
from maesn.policies import AbstractPolicy, PolicyInput

# Bounds of log σ before squashing, from the reference.
LOG_STD_BOUNDS = (-20.0, 2.0)


class SquashedPolicy(AbstractPolicy):
    """pi(a | o, z) = tanh(N(μ, σ²)), where one network of [o, z] gives μ and log σ."""

    mlp: MLP
    observed_reward: ObservedReward = eqx.field(static=True, default="own")
    """Kind of reward that episodes record for the context. The policy itself does not read it."""

    @property
    def distribution(self) -> type[SquashedGaussian]:
        return SquashedGaussian

    def __call__(
        self, policy_input: PolicyInput, z: Float[Array, " z"], recurrent_state: RecurrentState
    ) -> tuple[SquashedGaussian, RecurrentState]:
        return self.actions(policy_input.observation, z), recurrent_state

    def actions(
        self, observation: Float[Array, " observation"], z: Float[Array, " z"]
    ) -> SquashedGaussian:
        """Return the distribution of the action."""
        mean, log_std = jnp.split(self.mlp(jnp.concatenate([observation, z])), 2)
        return SquashedGaussian(mean, jnp.clip(log_std, *LOG_STD_BOUNDS))
