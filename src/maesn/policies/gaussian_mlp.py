"""The feed-forward Gaussian policy of the paper's appendix."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import ActionKind, Carry, Key
from maesn.networks import MLP, init_mlp
from maesn.numerics import DiagonalGaussian
from maesn.policies.base import AbstractPolicy, AbstractPolicySettings, PolicyInput
from maesn.policies.categorical_mlp import CategoricalMLP

# Floor of the action's standard deviation, from the reference's policy.
MINIMUM_STD = 1e-6


class GaussianMLPPolicy(AbstractPolicy):
    """pi(a | o, z) = N(mlp([o, z]), diag(exp(log_std)^2)), with a state-independent log_std."""

    mlp: MLP
    log_std: Float[Array, "*batch action"]

    def __call__(
        self, policy_input: PolicyInput, context: Float[Array, " context"], carry: Carry
    ) -> tuple[DiagonalGaussian, Carry]:
        mean = self.mlp(jnp.concatenate([policy_input.observation, context]))
        return DiagonalGaussian(mean, jnp.maximum(self.log_std, math.log(MINIMUM_STD))), carry

    def initial_recurrent_state(self) -> Carry:
        return None


class GaussianMLP(AbstractPolicySettings):
    """Settings of `GaussianMLPPolicy`."""

    hidden_sizes: tuple[int, ...] = (100, 100)
    """Widths of the hidden layers (appendix "Experimental Details": two layers of 100)."""
    initial_std: float = 1.0
    """Standard deviation of the actions at the start. Reference: 1."""

    def __check_init__(self) -> None:
        if any(size < 1 for size in self.hidden_sizes):
            raise ValueError(f"`hidden_sizes` must be positive, got {self.hidden_sizes}.")
        if self.initial_std <= 0:
            raise ValueError(f"`initial_std` must be positive, got {self.initial_std}.")

    def for_actions(self, kind: ActionKind) -> AbstractPolicySettings:
        if kind == "continuous" or self.initial_std != GaussianMLP.initial_std:
            return self
        return CategoricalMLP(self.hidden_sizes)

    def init(
        self, key: Key, observation_size: int, action_size: int, context_size: int
    ) -> GaussianMLPPolicy:
        sizes = (observation_size + context_size, *self.hidden_sizes, action_size)
        log_std = jnp.full(action_size, math.log(self.initial_std), dtype=float)
        return GaussianMLPPolicy(init_mlp(key, sizes), log_std)
