"""Gaussians with independent dimensions, for actions and for latents."""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from maesn.numerics.distribution import AbstractDistribution


class DiagonalGaussian(AbstractDistribution):
    """Product of normal distributions N(μ_d, σ_d²), d in [1, dim].

    The coordinates are (μ, log σ). The leading axes of an argument broadcast against those of the
    distribution; the last axis, `dim`, must agree.

    Attributes:
        mean: μ, in the unit of an event.
        log_std: log σ, of the same shape as `mean`.
    """

    mean: Float[Array, "*batch dim"]
    log_std: Float[Array, "*batch dim"]

    def __check_init__(self) -> None:
        if jnp.shape(self.mean) != jnp.shape(self.log_std):
            raise ValueError(
                "`mean` and `log_std` must have the same shape, but their shapes are "
                f"{jnp.shape(self.mean)} and {jnp.shape(self.log_std)}; broadcast one of them."
            )

    @staticmethod
    def standard(shape: tuple[int, ...]) -> "DiagonalGaussian":
        """The standard normal N(0, I).

        Args:
            shape: (*batch, dim).
        """
        return DiagonalGaussian(mean=jnp.zeros(shape), log_std=jnp.zeros(shape))

    @staticmethod
    def noise(key: PRNGKeyArray, shape: tuple[int, ...]) -> Float[Array, "*batch dim"]:
        """Draw ε ~ N(0, I)."""
        return jax.random.normal(key, shape)

    def sample_from_noise(self, noise: Float[Array, "*noise dim"]) -> Float[Array, "*batch dim"]:
        """The event x = μ + σ ε that belongs to a recorded noise.

        This is the pathwise (reparameterised) draw: differentiable in μ and log σ.

        Args:
            noise: ε, a standard normal draw.
        """
        mean, log_std, noise = _broadcast(self.mean, self.log_std, noise)
        return mean + jnp.exp(log_std) * noise

    def mode(self) -> Float[Array, "*batch dim"]:
        """The mean μ."""
        return self.mean

    def log_prob(self, value: Float[Array, "*value dim"]) -> Float[Array, "*batch"]:
        """Log-density of an event, in nats.

            log p(x) = -Σ_d [ ((x_d - μ_d)/σ_d)²/2 + log σ_d + log(2π)/2 ],  d in [1, dim]

        Args:
            value: x.
        """
        mean, log_std, value = _broadcast(self.mean, self.log_std, value)
        standardized = (value - mean) * jnp.exp(-log_std)
        return -jnp.sum(0.5 * standardized**2 + log_std + 0.5 * math.log(2 * math.pi), axis=-1)

    def kl(self, other: "DiagonalGaussian") -> Float[Array, "*batch"]:
        """Divergence KL(p ‖ q) of p = `self` from q = `other`, in nats.

        With the log-ratio δ_d = log σ_p,d - log σ_q,d,

            KL(p ‖ q) = ½ Σ_d [ exp(2δ_d) - 1 - 2δ_d + ((μ_p,d - μ_q,d)/σ_q,d)² ],  d in [1, dim].

        Written with expm1, its rounding error near p = q is of the order ε|δ| instead of ε:
        trust regions compare divergences of 1e-2 and less in single precision.
        """
        mean, log_std, other_mean, other_log_std = _broadcast(
            self.mean, self.log_std, other.mean, other.log_std
        )
        log_ratio = 2 * (log_std - other_log_std)
        distance = (mean - other_mean) * jnp.exp(-other_log_std)
        return 0.5 * jnp.sum(jnp.expm1(log_ratio) - log_ratio + distance**2, axis=-1)

    def entropy(self) -> Float[Array, "*batch"]:
        """Entropy H(p) = Σ_d [ log σ_d + log(2πe)/2 ], d in [1, dim], in nats."""
        return jnp.sum(self.log_std + 0.5 * math.log(2 * math.pi * math.e), axis=-1)

    def std(self) -> Float[Array, "*batch dim"]:
        return jnp.exp(self.log_std)

    def fisher_product(self, tangent: "DiagonalGaussian") -> "DiagonalGaussian":
        """Product of the Fisher information with a tangent (v_μ, v_logσ).

            F (v_μ, v_logσ) = (v_μ / σ², 2 v_logσ)

        F is diagonal: E[(∂ log p/∂μ)²] = 1/σ², and with ε = (x - μ)/σ,
        E[(∂ log p/∂ log σ)²] = E[(ε² - 1)²] = 2; the mixed term E[ε(ε² - 1)]/σ is 0.

        Args:
            tangent: v_μ in the field `mean`, v_logσ in the field `log_std`.
        """
        log_std, tangent_mean, tangent_log_std = _broadcast(
            self.log_std, tangent.mean, tangent.log_std
        )
        return DiagonalGaussian(
            mean=tangent_mean * jnp.exp(-2 * log_std), log_std=2 * tangent_log_std
        )


def _broadcast(*arrays: Float[Array, "..."]) -> list[Float[Array, "*batch dim"]]:
    """Broadcast the leading axes, after checking that the last axes agree.

    Explicit, because a one-dimensional event must not spread silently over `dim`.
    """
    dims = {jnp.shape(array)[-1:] for array in arrays}
    if len(dims) != 1:
        raise ValueError(
            "The last axis of `mean` and of the argument must be the same number of dimensions, "
            f"but the shapes are {[jnp.shape(array) for array in arrays]}; only leading axes "
            "broadcast."
        )
    return jnp.broadcast_arrays(*arrays)
