"""The last step of a policy: from a network's outputs to a distribution of actions."""

import math
from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import ActionKind
from maesn.numerics import AbstractDistribution, Categorical, DiagonalGaussian

# Least standard deviation of an action, from the reference's policy.
MINIMUM_STD = 1e-6


class AbstractHead(eqx.Module):
    """Turns one output for each component of an action into a distribution."""

    @abstractmethod
    def __call__(self, outputs: Float[Array, " action"]) -> AbstractDistribution:
        """Return the distribution of the action."""

    @property
    @abstractmethod
    def action_kind(self) -> ActionKind:
        """The kind of actions."""


class GaussianHead(AbstractHead):
    """N(outputs, diag(exp(log_std)^2)), with a state-independent log_std."""

    log_std: Float[Array, "*batch action"]

    def __call__(self, outputs: Float[Array, " action"]) -> DiagonalGaussian:
        return DiagonalGaussian(outputs, jnp.maximum(self.log_std, math.log(MINIMUM_STD)))

    @property
    def action_kind(self) -> ActionKind:
        return "continuous"


class CategoricalHead(AbstractHead):
    """One choice, with the outputs as logits."""

    def __call__(self, outputs: Float[Array, " action"]) -> Categorical:
        return Categorical(outputs)

    @property
    def action_kind(self) -> ActionKind:
        return "discrete"


def make_head(action_kind: ActionKind, action_size: int, initial_std: float) -> AbstractHead:
    """Return the head for a kind of actions; continuous ones start with that standard deviation."""
    if action_kind == "discrete":
        return CategoricalHead()
    return GaussianHead(initial_log_std(action_size, initial_std))


def initial_log_std(action_size: int, initial_std: float) -> Float[Array, " action"]:
    """Return the `log_std` of a Gaussian policy that has learned nothing yet."""
    return jnp.full(action_size, math.log(initial_std), dtype=float)
