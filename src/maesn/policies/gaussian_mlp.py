"""The feed-forward Gaussian policy of the paper's appendix."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import ActionKind, Key, RecurrentState
from maesn.networks import MLP, init_mlp
from maesn.numerics import DiagonalGaussian
from maesn.policies.base import AbstractPolicy, AbstractPolicySettings, PolicyInput
from maesn.policies.categorical_mlp import CategoricalMLP
from maesn.policies.heads import GaussianHead, initial_log_std


class GaussianMLPPolicy(AbstractPolicy):
    """pi(a | o, z) = N(mlp([o, z]), diag(exp(log_std)^2)), with a state-independent log_std."""

    mlp: MLP
    log_std: Float[Array, "*batch action"]

    def __call__(
        self, policy_input: PolicyInput, z: Float[Array, " z"], recurrent_state: RecurrentState
    ) -> tuple[DiagonalGaussian, RecurrentState]:
        mean = self.mlp(jnp.concatenate([policy_input.observation, z]))
        return GaussianHead(self.log_std)(mean), recurrent_state

    def initial_recurrent_state(self) -> RecurrentState:
        return None


class GaussianMLP(AbstractPolicySettings):
    """Settings of `GaussianMLPPolicy`."""

    hidden_sizes: tuple[int, ...] = (100, 100)
    """Widths of the hidden layers. Paper: two layers of 100 (appendix "Experimental Details")."""
    initial_std: float = 1.0
    """Standard deviation of the actions before training. Reference: 1."""

    def __check_init__(self) -> None:
        if any(size < 1 for size in self.hidden_sizes):
            raise ValueError(f"`hidden_sizes` must be positive, got {self.hidden_sizes}.")
        if not self.initial_std > 0:
            raise ValueError(f"`initial_std` must be positive, got {self.initial_std}.")

    def for_actions(self, kind: ActionKind) -> AbstractPolicySettings:
        if kind == "continuous" or self.initial_std != GaussianMLP.initial_std:
            return self
        return CategoricalMLP(self.hidden_sizes)

    def init(
        self, key: Key, observation_size: int, action_size: int, z_size: int
    ) -> GaussianMLPPolicy:
        sizes = (observation_size + z_size, *self.hidden_sizes, action_size)
        log_std = initial_log_std(action_size, self.initial_std)
        return GaussianMLPPolicy(init_mlp(key, sizes), log_std)
