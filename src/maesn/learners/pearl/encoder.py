"""The context encoder: a posterior over z as a product of one Gaussian factor per transition.

Rakelly et al. 2019, https://arxiv.org/abs/1903.08254, section 4.1:

    q(z | c) ∝ Π_n N(z; μ(c_n), σ²(c_n)),    c_n = (o, a, r) of transition n

The order of the transitions does not matter. As in the reference, the prior N(0, I) is no factor:
it stands for the posterior where there is no transition yet.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.axes import Key
from maesn.context import Latent
from maesn.networks import MLP, init_mlp
from maesn.settings import check_least, check_sizes

# Least variance of a factor, from the reference.
LEAST_VARIANCE = 1e-7


class Factors(NamedTuple):
    """A product of Gaussian factors by its natural parameters, which add up."""

    precision: Float[Array, "*batch z"]
    """Σ_n 1/σ_n²; 0 for the product of none."""
    weighted: Float[Array, "*batch z"]
    """Σ_n μ_n/σ_n²."""

    def times(self, other: "Factors") -> "Factors":
        """Return the product of two products."""
        return Factors(self.precision + other.precision, self.weighted + other.weighted)

    def posterior(self) -> Latent:
        """Return N(Σ μ/σ² / Σ 1/σ², 1 / Σ 1/σ²); the prior N(0, I) for the product of none."""
        none = self.precision == 0
        precision = jnp.where(none, 1.0, self.precision)
        return Latent(self.weighted / precision, -0.5 * jnp.log(precision))


class ContextEncoder(eqx.Module):
    """The network of the factors: transition -> (μ, σ²)."""

    mlp: MLP

    @property
    def size(self) -> int:
        """Number of components of z."""
        return self.mlp.layers[-1].bias.shape[-1] // 2

    def none(self, num_tasks: int) -> Factors:
        """Return the product of no factor, in every task."""
        zeros = jnp.zeros((num_tasks, self.size))
        return Factors(zeros, zeros)

    def __call__(
        self, context: Float[Array, "transition feature"], valid: Bool[Array, " transition"]
    ) -> Factors:
        """Return the product of the factors of the valid transitions of one task."""
        mean, raw = jnp.split(jax.vmap(self.mlp)(context), 2, axis=-1)
        variance = jnp.maximum(jax.nn.softplus(raw), LEAST_VARIANCE)
        precision = jnp.where(valid[:, None], 1.0 / variance, 0.0)
        return Factors(precision.sum(0), (precision * mean).sum(0))


class EncoderSettings(eqx.Module):
    """Settings of a `ContextEncoder`."""

    latent_size: int = 5
    """Components of z. Reference: 5."""
    hidden_sizes: tuple[int, ...] = (200, 200, 200)
    """Widths of the hidden layers. Reference: three layers of 200."""
    kl_weight: float = 0.1
    """Weight of the sum over tasks of KL(q(z | c) || N(0, I)), beside the mean squared error of the
    critics. Reference: 0.1; 1 on sparse point goals."""
    context_size: int = 64
    """Transitions of a task that a gradient step infers z from. Reference: 64; 1024 on point
    goals."""
    next_observation: bool = False
    """Whether the next observation is part of the context, for tasks that differ in dynamics."""

    def __check_init__(self) -> None:
        check_least(self, latent_size=1, context_size=1, kl_weight=0)
        check_sizes(self, "hidden_sizes")

    def init(self, key: Key, observation_size: int, action_size: int) -> ContextEncoder:
        """Return freshly initialised weights."""
        features = observation_size + action_size + 1 + self.next_observation * observation_size
        sizes = (features, *self.hidden_sizes, 2 * self.latent_size)
        return ContextEncoder(init_mlp(key, sizes))
