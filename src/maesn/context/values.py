"""Contexts: arrays of one task, from which z, an input of the policy, is drawn."""

import math
from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from maesn.axes import Key
from maesn.numerics import DiagonalGaussian

# Standard deviation of a latent that is held at its mean: small enough not to matter, and its
# logarithm is finite.
FIXED_STD = 1e-6


class AbstractContext(eqx.Module):
    """The context of one task, or of many, stacked: arrays only."""

    @abstractmethod
    def draw(
        self, noise: Float[Array, " noise"], description: Float[Array, " description"]
    ) -> Float[Array, " z"]:
        """Return z, the policy's constant input during one episode.

        It follows from the episode's draw of `noise` and the description of its task.
        """

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of components of z."""

    @property
    def description_size(self) -> int:
        """Number of components of the description that z is made of; 0 except for an oracle."""
        return 0

    def noise(self, key: Key, episode: Int[Array, ""]) -> Float[Array, " noise"]:
        """Draw the noise of the z of one episode, by its key; by default nothing is random.

        The episode's index is that among those that are played side by side.
        """
        return jnp.zeros(0)

    def at_mean(self) -> "AbstractContext":
        """Return a context with z fixed at its mean: this one if z is not random."""
        return self

    def widened(self, factor: float) -> "AbstractContext":
        """Return a context with `factor` times the standard deviation of z; see `at_mean`."""
        return self


class Nothing(AbstractContext):
    """The context of `NoContext`."""

    @property
    def size(self) -> int:
        return 0

    def draw(
        self, noise: Float[Array, " noise"], description: Float[Array, " description"]
    ) -> Float[Array, " z"]:
        return noise


class Bias(AbstractContext):
    """The context of `BiasContext`: z is the value itself."""

    value: Float[Array, "*batch z"]

    @property
    def size(self) -> int:
        return self.value.shape[-1]

    def draw(
        self, noise: Float[Array, " noise"], description: Float[Array, " description"]
    ) -> Float[Array, " z"]:
        return self.value


class Latent(AbstractContext):
    """The context of `LatentContext`: the distribution N(mean, exp(log_std)^2) of one task."""

    mean: Float[Array, "*batch z"]
    log_std: Float[Array, "*batch z"]

    @property
    def size(self) -> int:
        return self.mean.shape[-1]

    @property
    def distribution(self) -> DiagonalGaussian:
        """q(z), the distribution that z is drawn from."""
        return DiagonalGaussian(self.mean, self.log_std)

    def noise(self, key: Key, episode: Int[Array, ""]) -> Float[Array, " z"]:
        """Draw standard normal noise."""
        return jax.random.normal(key, (self.size,))

    def draw(
        self, noise: Float[Array, " noise"], description: Float[Array, " description"]
    ) -> Float[Array, " z"]:
        """Return z = mean + exp(log_std) * noise."""
        return self.distribution.sample_from_noise(noise)

    @staticmethod
    def fixed(mean: Float[Array, "*batch z"]) -> "Latent":
        """Return N(mean, 1e-12 I), from which z is the mean up to rounding."""
        return Latent(mean, jnp.full_like(mean, math.log(FIXED_STD)))

    def at_mean(self) -> "Latent":
        return Latent.fixed(self.mean)

    def widened(self, factor: float) -> "Latent":
        """Return N(mean, (factor std)^2 I)."""
        return Latent(self.mean, self.log_std + math.log(factor))


class LatentPerEpisode(AbstractContext):
    """A latent for each of the episodes that are played side by side in a task."""

    latents: Float[Array, "*batch episode z"]

    @property
    def size(self) -> int:
        return self.latents.shape[-1]

    def noise(self, key: Key, episode: Int[Array, ""]) -> Float[Array, " z"]:
        """Return the episode's latent: nothing is random."""
        return self.latents[episode]

    def draw(
        self, noise: Float[Array, " noise"], description: Float[Array, " description"]
    ) -> Float[Array, " z"]:
        return noise


def held_at(latents: Float[ArrayLike, "task *episode z"]) -> Latent | LatentPerEpisode:
    """Return contexts whose z is given: one for each task, or for each episode of it."""
    held = jnp.asarray(latents, jnp.float32)
    return Latent.fixed(held) if held.ndim == 2 else LatentPerEpisode(held)


class TaskDescription(AbstractContext):
    """The context of `OracleContext`: z is the description of the task."""

    size_of_description: int = eqx.field(static=True)

    @property
    def size(self) -> int:
        return self.size_of_description

    @property
    def description_size(self) -> int:
        return self.size_of_description

    def draw(
        self, noise: Float[Array, " noise"], description: Float[Array, " description"]
    ) -> Float[Array, " z"]:
        return description
