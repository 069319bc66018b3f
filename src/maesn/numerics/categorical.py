"""A choice among finitely many, for discrete actions."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from maesn.numerics.distribution import AbstractDistribution


class Categorical(AbstractDistribution):
    """One choice k in [1, K] with probability p_k = exp(l_k) / Σ_j exp(l_j).

    Events are one-hot vectors, so that learners treat both kinds of actions alike.
    The coordinates are the logits l; adding a number to all of them changes nothing.

    Attributes:
        logits: l, of any scale.
    """

    logits: Float[Array, "*batch choice"]

    @property
    def log_probabilities(self) -> Float[Array, "*batch choice"]:
        """Log p_k."""
        return jax.nn.log_softmax(self.logits)

    @property
    def probabilities(self) -> Float[Array, "*batch choice"]:
        """p_k."""
        return jax.nn.softmax(self.logits)

    @staticmethod
    def noise(key: PRNGKeyArray, shape: tuple[int, ...]) -> Float[Array, "*batch choice"]:
        """Draw g_k ~ Gumbel(0, 1)."""
        return jax.random.gumbel(key, shape)

    def sample_from_noise(
        self, noise: Float[Array, "*noise choice"]
    ) -> Float[Array, "*batch choice"]:
        """The choice argmax_k (l_k + g_k) that belongs to a recorded noise, as a one-hot vector.

        Args:
            noise: g, a standard Gumbel draw.
        """
        return _one_hot_maximum(self.logits + noise)

    def mode(self) -> Float[Array, "*batch choice"]:
        """The most probable choice, as a one-hot vector."""
        return _one_hot_maximum(self.logits)

    def log_prob(self, value: Float[Array, "*batch choice"]) -> Float[Array, "*batch"]:
        """Log-probability Σ_k x_k log p_k of a one-hot event x, in nats."""
        return jnp.sum(value * self.log_probabilities, axis=-1)

    def kl(self, other: "Categorical") -> Float[Array, "*batch"]:
        """Divergence KL(p ‖ q) of p = `self` from q = `other`, in nats.

        With the log-ratio δ_k = log q_k - log p_k, and since Σ_k p_k (exp(δ_k) - 1) = 0,

            KL(p ‖ q) = -Σ_k p_k δ_k = Σ_k p_k [ exp(δ_k) - 1 - δ_k ].

        The second form has no negative terms: near p = q, where trust regions look, the first
        would lose the result in the rounding errors of its sum.
        """
        log_ratio = other.log_probabilities - self.log_probabilities
        return jnp.sum(self.probabilities * (jnp.expm1(log_ratio) - log_ratio), axis=-1)

    def entropy(self) -> Float[Array, "*batch"]:
        """Entropy H(p) = -Σ_k p_k log p_k, in nats."""
        return -jnp.sum(self.probabilities * self.log_probabilities, axis=-1)

    def std(self) -> Float[Array, "*batch choice"]:
        """Standard deviation √(p_k (1 - p_k)) of every component of the one-hot vector."""
        return jnp.sqrt(self.probabilities * (1.0 - self.probabilities))

    def fisher_product(self, tangent: "Categorical") -> "Categorical":
        """Product of the Fisher information with a tangent v of the logits.

            (F v)_k = p_k (v_k - Σ_j p_j v_j)

        since ∂ log p(x)/∂l = x - p, so that F = E[(x - p)(x - p)ᵀ] = diag(p) - p pᵀ.

        Args:
            tangent: v in the field `logits`.
        """
        mean = jnp.sum(self.probabilities * tangent.logits, axis=-1, keepdims=True)
        return Categorical(self.probabilities * (tangent.logits - mean))


def _one_hot_maximum(scores: Float[Array, "*batch choice"]) -> Float[Array, "*batch choice"]:
    return jax.nn.one_hot(jnp.argmax(scores, axis=-1), scores.shape[-1], dtype=scores.dtype)
