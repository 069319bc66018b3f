"""The policy of soft actor-critic: a squashed Gaussian whose spread depends on the observation."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import Key, ObservedReward, RecurrentState
from maesn.networks import MLP, init_mlp
from maesn.numerics import SquashedGaussian
from maesn.policies import AbstractPolicy, PolicyInput

# Bounds of log σ before squashing, from the reference.
LOG_STD_BOUNDS = (-20.0, 2.0)
# Factor on the weights of the last layer at the start: the mean is then 0 and σ is 1 everywhere.
FIRST_SCALE = 1e-2


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


def init_policy(key: Key, sizes: tuple[int, ...], shown: ObservedReward) -> SquashedPolicy:
    """Return a policy that acts nearly alike everywhere.

    Args:
        key: random key.
        sizes: components of observation and z together, widths of the hidden layers, and components
            of an action.
        shown: kind of reward in the context.
    """
    mlp = init_mlp(key, (*sizes[:-1], 2 * sizes[-1]))
    scaled = eqx.tree_at(
        lambda mlp: mlp.layers[-1].weight, mlp, replace_fn=lambda w: w * FIRST_SCALE
    )
    return SquashedPolicy(scaled, shown)
