"""Gaussians that a hyperbolic tangent maps into (-1, 1), for actions with limits."""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from maesn.numerics.distribution import AbstractDistribution
from maesn.numerics.gaussian import DiagonalGaussian

# Nodes of Gauss-Hermite quadrature for moments without a closed form. With 32, entropies are exact
# to 1e-3 nats up to a standard deviation of 2.
QUADRATURE_NODES = 32
# The farthest event whose log-density is asked for: single precision rounds tanh(9) to 1, of which
# the inverse is infinite.
LARGEST_EVENT = 1.0 - 1e-6


class SquashedGaussian(AbstractDistribution):
    """The distribution of x = tanh(u) with u ~ N(μ, σ²), in every dimension.

    The coordinates are (μ, log σ) of u. The map is one to one, so that divergences and the Fisher
    information are those of u. Source: Haarnoja et al. 2018, https://arxiv.org/abs/1801.01290,
    appendix C.

    Attributes:
        mean: μ, before squashing.
        log_std: log σ, of the same shape as `mean`.
    """

    mean: Float[Array, "*batch dim"]
    log_std: Float[Array, "*batch dim"]

    @property
    def unsquashed(self) -> DiagonalGaussian:
        """The distribution N(μ, σ²) of u."""
        return DiagonalGaussian(self.mean, self.log_std)

    @staticmethod
    def noise(key: PRNGKeyArray, shape: tuple[int, ...]) -> Float[Array, "*batch dim"]:
        """Draw ε ~ N(0, I)."""
        return DiagonalGaussian.noise(key, shape)

    def sample_from_noise(self, noise: Float[Array, "*noise dim"]) -> Float[Array, "*batch dim"]:
        """The event x = tanh(μ + σ ε), differentiable in μ and log σ."""
        return jnp.tanh(self.unsquashed.sample_from_noise(noise))

    def sample_and_log_prob(
        self, noise: Float[Array, "*noise dim"]
    ) -> tuple[Float[Array, "*batch dim"], Float[Array, "*batch"]]:
        """Return the event of a noise and its log-density, without inverting the tangent.

        Both are differentiable in μ and log σ, and the log-density is exact near the limits.
        """
        u = self.unsquashed.sample_from_noise(noise)
        return jnp.tanh(u), self.unsquashed.log_prob(u) - log_slope(u).sum(-1)

    def mode(self) -> Float[Array, "*batch dim"]:
        """The squashed mean tanh(μ), which is the median of x."""
        return jnp.tanh(self.mean)

    def log_prob(self, value: Float[Array, "*value dim"]) -> Float[Array, "*batch"]:
        """Log-density of an event, in nats, by the change of variables.

            log p(x) = log N(u; μ, σ²) - Σ_d log(1 - x_d²),  u = artanh(x)

        Args:
            value: x, which is moved into [-`LARGEST_EVENT`, `LARGEST_EVENT`].
        """
        u = jnp.arctanh(jnp.clip(value, -LARGEST_EVENT, LARGEST_EVENT))
        return self.unsquashed.log_prob(u) - log_slope(u).sum(-1)

    def kl(self, other: "SquashedGaussian") -> Float[Array, "*batch"]:
        """Divergence KL(p ‖ q), equal to that of the Gaussians before squashing."""
        return self.unsquashed.kl(other.unsquashed)

    def entropy(self) -> Float[Array, "*batch"]:
        """Entropy H(p) = H(u) + Σ_d E[log(1 - tanh²(u_d))], in nats, by quadrature."""
        return self.unsquashed.entropy() + self._expectation(log_slope).sum(-1)

    def std(self) -> Float[Array, "*batch dim"]:
        """Standard deviation of every component of x, by quadrature."""
        mean = self._expectation(jnp.tanh)
        # Centred, because near the limits both moments are 1 up to rounding.
        return jnp.sqrt(self._expectation(lambda u: (jnp.tanh(u) - mean) ** 2))

    def fisher_product(self, tangent: "SquashedGaussian") -> "SquashedGaussian":
        """Product of the Fisher information with a tangent, equal to that before squashing."""
        product = self.unsquashed.fisher_product(tangent.unsquashed)
        return SquashedGaussian(product.mean, product.log_std)

    def _expectation(
        self, function: Callable[[Float[Array, "..."]], Float[Array, "..."]]
    ) -> Float[Array, "*batch dim"]:
        """Return E[function(u)] in every dimension."""
        nodes, weights = np.polynomial.hermite_e.hermegauss(QUADRATURE_NODES)
        total = jnp.zeros_like(self.mean)
        for node, weight in zip(nodes.tolist(), (weights / weights.sum()).tolist(), strict=True):
            total = total + weight * function(self.mean + jnp.exp(self.log_std) * node)
        return total


def log_slope(u: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Return log(1 - tanh²(u)), the log-derivative of tanh.

    Written as 2 (log 2 - u - softplus(-2u)), it is finite where 1 - tanh²(u) rounds to 0.
    """
    return 2.0 * (math.log(2.0) - u - jax.nn.softplus(-2.0 * u))
