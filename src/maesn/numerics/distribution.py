"""The interface of distributions of actions and latents."""

from abc import abstractmethod
from typing import TypeVar

import equinox as eqx
from jaxtyping import Array, Float, PRNGKeyArray, Shaped

Distribution = TypeVar("Distribution", bound="AbstractDistribution")


class AbstractDistribution(eqx.Module):
    """A batch of independent distributions, whose array fields are its coordinates.

    The leading axes `*batch` of the fields index independent distributions. Events (one action,
    one latent) have the axes of one sample; all results except samples have the axes `*batch`
    alone. Subclasses are final: they implement every method and are not subclassed again.
    """

    @staticmethod
    @abstractmethod
    def noise(key: PRNGKeyArray, shape: tuple[int, ...]) -> Float[Array, "*sample"]:
        """Draw the noise of events of this shape. It does not depend on the coordinates."""

    @abstractmethod
    def sample_from_noise(self, noise: Float[Array, "*noise"]) -> Shaped[Array, "*sample"]:
        """The event for a given noise."""

    @abstractmethod
    def mode(self) -> Shaped[Array, "*sample"]:
        """The event without noise: a mean, a squashed mean, or the most probable choice."""

    @abstractmethod
    def log_prob(self, value: Shaped[Array, "*event"]) -> Float[Array, "*batch"]:
        """Log-density log p(x) of the events `value`, in nats."""

    @abstractmethod
    def kl(self: Distribution, other: Distribution) -> Float[Array, "*batch"]:
        """Divergence KL(p ‖ q) = E_p[log p(x) - log q(x)], with p = `self` and q = `other`."""

    @abstractmethod
    def entropy(self) -> Float[Array, "*batch"]:
        """Entropy H(p) = -E_p[log p(x)], in nats."""

    @abstractmethod
    def std(self) -> Float[Array, "*sample"]:
        """Standard deviation of every component of an event."""

    @abstractmethod
    def fisher_product(self: Distribution, tangent: Distribution) -> Distribution:
        """Product F v of the Fisher information with a tangent.

            F = E_p[∇ log p(x) ∇ log p(x)ᵀ] = ∇²_η KL(p_θ ‖ p_η) at η = θ

        with respect to the array fields.

        Args:
            tangent: the direction v; its fields hold the change of the field of the same name.

        Returns:
            F v, in the same layout.
        """
