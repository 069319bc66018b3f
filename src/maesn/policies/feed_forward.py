"""Feed-forward policies: the Gaussian one of the paper's appendix, and one of choices."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import ActionKind, Key, RecurrentState
from maesn.networks import MLP, init_mlp
from maesn.numerics import Categorical, DiagonalGaussian
from maesn.policies.base import AbstractPolicy, AbstractPolicySettings, PolicyInput
from maesn.settings import check_positive, check_sizes

# Least standard deviation of an action, from the reference's policy.
MINIMUM_STD = 1e-6


def gaussian(mean: Float[Array, " action"], log_std: Float[Array, " action"]) -> DiagonalGaussian:
    """Return N(mean, diag(exp(log_std)^2)), with at least the least standard deviation."""
    return DiagonalGaussian(mean, jnp.maximum(log_std, math.log(MINIMUM_STD)))


def initial_log_std(action_size: int, initial_std: float) -> Float[Array, " action"]:
    """Return the `log_std` of a Gaussian policy that has learned nothing yet."""
    return jnp.full(action_size, math.log(initial_std), dtype=float)


class GaussianMLPPolicy(AbstractPolicy):
    """pi(a | o, z) = N(mlp([o, z]), diag(exp(log_std)^2)), with a state-independent log_std."""

    mlp: MLP
    log_std: Float[Array, "*batch action"]

    def __call__(
        self, policy_input: PolicyInput, z: Float[Array, " z"], recurrent_state: RecurrentState
    ) -> tuple[DiagonalGaussian, RecurrentState]:
        mean = self.mlp(jnp.concatenate([policy_input.observation, z]))
        return gaussian(mean, self.log_std), recurrent_state


class CategoricalMLPPolicy(AbstractPolicy):
    """pi(a | o, z) = softmax(mlp([o, z]))_a."""

    mlp: MLP

    def __call__(
        self, policy_input: PolicyInput, z: Float[Array, " z"], recurrent_state: RecurrentState
    ) -> tuple[Categorical, RecurrentState]:
        logits = self.mlp(jnp.concatenate([policy_input.observation, z]))
        return Categorical(logits), recurrent_state

    @property
    def distribution(self) -> type[Categorical]:
        return Categorical


class GaussianMLP(AbstractPolicySettings):
    """Settings of `GaussianMLPPolicy`."""

    hidden_sizes: tuple[int, ...] = (100, 100)
    """Widths of the hidden layers. Paper: two layers of 100 (appendix "Experimental Details")."""
    initial_std: float = 1.0
    """Standard deviation of the actions before training. Reference: 1."""

    def __check_init__(self) -> None:
        check_sizes(self, "hidden_sizes")
        check_positive(self, "initial_std")

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


USUAL: dict[ActionKind, AbstractPolicySettings] = {
    "continuous": GaussianMLP(),
    "discrete": CategoricalMLP(),
}
"""The usual feed-forward policy for each kind of actions."""
