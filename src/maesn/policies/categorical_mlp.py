"""A feed-forward policy of discrete actions."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import ActionKind, Key, RecurrentState
from maesn.networks import MLP, init_mlp
from maesn.numerics import Categorical
from maesn.policies.base import AbstractPolicy, AbstractPolicySettings, PolicyInput
from maesn.settings import check_sizes


class CategoricalMLPPolicy(AbstractPolicy):
    """pi(a | o, z) = softmax(mlp([o, z]))_a."""

    mlp: MLP

    def __call__(
        self, policy_input: PolicyInput, z: Float[Array, " z"], recurrent_state: RecurrentState
    ) -> tuple[Categorical, RecurrentState]:
        logits = self.mlp(jnp.concatenate([policy_input.observation, z]))
        return Categorical(logits), recurrent_state

    @property
    def action_kind(self) -> ActionKind:
        return "discrete"


class CategoricalMLP(AbstractPolicySettings):
    """Settings of `CategoricalMLPPolicy`."""

    hidden_sizes: tuple[int, ...] = (100, 100)
    """Widths of the hidden layers, as of `GaussianMLP`."""

    def __check_init__(self) -> None:
        check_sizes(self, "hidden_sizes")

    def init(
        self, key: Key, observation_size: int, action_size: int, z_size: int
    ) -> CategoricalMLPPolicy:
        sizes = (observation_size + z_size, *self.hidden_sizes, action_size)
        return CategoricalMLPPolicy(init_mlp(key, sizes))
