"""The values of contexts: arrays of one task, and how a policy's input is drawn from them."""

from abc import abstractmethod

import equinox as eqx
from jaxtyping import Array, Float

from maesn.numerics import DiagonalGaussian


class AbstractContextValue(eqx.Module):
    """The context of one task: arrays only."""

    @abstractmethod
    def draw(self, noise: Float[Array, " noise"]) -> Float[Array, " context"]:
        """Return what the policy is fed during one episode, given the episode's random draw."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of components that are fed to the policy."""

    @property
    @abstractmethod
    def noise_size(self) -> int:
        """Number of standard normal components behind one draw."""


class Nothing(AbstractContextValue):
    """The value of `NoContext`."""

    @property
    def size(self) -> int:
        return 0

    @property
    def noise_size(self) -> int:
        return 0

    def draw(self, noise: Float[Array, " noise"]) -> Float[Array, " context"]:
        return noise


class Bias(AbstractContextValue):
    """The value of `BiasContext`: fed to the policy as it is."""

    value: Float[Array, "*batch context"]

    @property
    def size(self) -> int:
        return self.value.shape[-1]

    @property
    def noise_size(self) -> int:
        return 0

    def draw(self, noise: Float[Array, " noise"]) -> Float[Array, " context"]:
        return self.value


class Latent(AbstractContextValue):
    """The value of `LatentContext`: the distribution N(mean, exp(log_std)^2) of one task."""

    mean: Float[Array, "*batch context"]
    log_std: Float[Array, "*batch context"]

    @property
    def size(self) -> int:
        return self.mean.shape[-1]

    @property
    def noise_size(self) -> int:
        return self.mean.shape[-1]

    @property
    def distribution(self) -> DiagonalGaussian:
        """q(z), the distribution that z is drawn from."""
        return DiagonalGaussian(self.mean, self.log_std)

    def draw(self, noise: Float[Array, " noise"]) -> Float[Array, " context"]:
        """Return z = mean + exp(log_std) * noise."""
        return self.distribution.sample_from_noise(noise)
