"""The last step of a policy: from a network's outputs to a distribution of actions."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import ActionKind
from maesn.numerics import AbstractDistribution, Categorical, DiagonalGaussian

# Least standard deviation of an action, from the reference's policy.
MINIMUM_STD = 1e-6


class Head(eqx.Module):
    """Turns one output for each component of an action into a distribution.

    N(outputs, diag(exp(log_std)^2)), or one choice, with the outputs as logits.
    """

    log_std: Float[Array, "*batch action"] | None
    """State-independent; None for choices."""

    def __call__(self, outputs: Float[Array, " action"]) -> AbstractDistribution:
        if self.log_std is None:
            return Categorical(outputs)
        return gaussian(outputs, self.log_std)

    @property
    def action_kind(self) -> ActionKind:
        """The kind of actions."""
        return "discrete" if self.log_std is None else "continuous"


def gaussian(mean: Float[Array, " action"], log_std: Float[Array, " action"]) -> DiagonalGaussian:
    """Return N(mean, diag(exp(log_std)^2)), with at least the least standard deviation."""
    return DiagonalGaussian(mean, jnp.maximum(log_std, math.log(MINIMUM_STD)))


def initial_log_std(action_size: int, initial_std: float) -> Float[Array, " action"]:
    """Return the `log_std` of a Gaussian policy that has learned nothing yet."""
    return jnp.full(action_size, math.log(initial_std), dtype=float)
