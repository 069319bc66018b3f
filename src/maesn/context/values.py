"""The values of contexts: arrays of one task, and how a policy's input is drawn from them."""

from abc import abstractmethod

import equinox as eqx
import jax
from jaxtyping import Array, Float

from maesn.axes import Key
from maesn.numerics import DiagonalGaussian


class AbstractContext(eqx.Module):
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
        """Number of components behind one draw."""

    def noise(self, key: Key, description: Float[Array, " description"]) -> Float[Array, " noise"]:
        """Return what one draw is made from: standard normal components, unless it is told.

        Args:
            key: random key.
            description: what tells the episode's task from all others.
        """
        return jax.random.normal(key, (self.noise_size,))


class Nothing(AbstractContext):
    """The value of `NoContext`."""

    @property
    def size(self) -> int:
        return 0

    @property
    def noise_size(self) -> int:
        return 0

    def draw(self, noise: Float[Array, " noise"]) -> Float[Array, " context"]:
        return noise


class Bias(AbstractContext):
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


class Latent(AbstractContext):
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


class TaskDescription(AbstractContext):
    """The value of `OracleContext`: the description of the task takes the place of the noise.

    So whoever plays an episode hands the description over, and it is recorded with the episode.
    """

    description_size: int = eqx.field(static=True)

    @property
    def size(self) -> int:
        return self.description_size

    @property
    def noise_size(self) -> int:
        return self.description_size

    def noise(self, key: Key, description: Float[Array, " description"]) -> Float[Array, " noise"]:
        """Return the description; nothing about it is random."""
        return description

    def draw(self, noise: Float[Array, " noise"]) -> Float[Array, " context"]:
        return noise
