"""A feed-forward policy of discrete actions."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import ActionKind, Carry, Key
from maesn.networks import MLP, init_mlp
from maesn.numerics import Categorical
from maesn.policies.base import AbstractPolicy, AbstractPolicySettings, PolicyInput


class CategoricalMLPPolicy(AbstractPolicy):
    """pi(a | o, z) = softmax(mlp([o, z]))_a."""

    mlp: MLP

    def __call__(
        self, policy_input: PolicyInput, context: Float[Array, " context"], carry: Carry
    ) -> tuple[Categorical, Carry]:
        return Categorical(self.mlp(jnp.concatenate([policy_input.observation, context]))), carry

    def initial_recurrent_state(self) -> Carry:
        return None

    @property
    def action_kind(self) -> ActionKind:
        return "discrete"


class CategoricalMLP(AbstractPolicySettings):
    """Settings of `CategoricalMLPPolicy`."""

    hidden_sizes: tuple[int, ...] = (100, 100)
    """Widths of the hidden layers, as of `GaussianMLP`."""

    def __check_init__(self) -> None:
        if any(size < 1 for size in self.hidden_sizes):
            raise ValueError(f"`hidden_sizes` must be positive, got {self.hidden_sizes}.")

    def init(
        self, key: Key, observation_size: int, action_size: int, context_size: int
    ) -> CategoricalMLPPolicy:
        sizes = (observation_size + context_size, *self.hidden_sizes, action_size)
        return CategoricalMLPPolicy(init_mlp(key, sizes))
