"""Normalisation of observations by the mean and variance of all observations in training.

The statistics belong to no gradient: they stay as they are while a learner steps, and afterwards
take in what it has played. In a new task they are frozen, as adaptation is learned around them.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.numerics import mesh

# Added to the variance, as Gymnasium's `NormalizeObservation` does: components that never change
# must not be divided by 0.
EPSILON = 1e-8


class ObservationStatistics(eqx.Module):
    """Running mean and variance of every component of the observations."""

    count: Float[Array, ""]
    mean: Float[Array, " observation"]
    variance: Float[Array, " observation"]

    def normalized(
        self, observation: Float[Array, "*steps observation"]
    ) -> Float[Array, "*steps observation"]:
        """Return (o - mean) / sqrt(variance + epsilon); before any observation, o itself."""
        shifted = observation - jnp.broadcast_to(self.mean, observation.shape)
        return shifted / jnp.broadcast_to(self.scale, observation.shape)

    @property
    def scale(self) -> Float[Array, " observation"]:
        """What observations are divided by."""
        return jnp.sqrt(self.variance + EPSILON)

    def with_batch(
        self, observation: Float[Array, "*batch observation"], seen: Bool[Array, "*batch"]
    ) -> "ObservationStatistics":
        """Take in more observations, in a way that does not lose digits.

        With n, m, v of what came before, n', m', v' of the batch, N = n + n' and d = m' - m,

            mean = m + d n' / N,  variance = (n v + n' v') / N + d^2 n n' / N^2

        (Chan, Golub and LeVeque 1979, "Updating formulae and a pairwise algorithm").

        Args:
            observation: of any number of steps; of this device, where devices share the tasks.
            seen: which of them count; the others may be anything.
        """
        axes, some = tuple(range(seen.ndim)), seen[..., None]
        new = mesh.total(seen.sum()).astype(float)
        safe = jnp.maximum(new, 1.0)
        mean = mesh.total(jnp.where(some, observation, 0.0).sum(axes)) / safe
        centred = jnp.where(some, observation - jnp.broadcast_to(mean, observation.shape), 0.0)
        variance = mesh.total((centred**2).sum(axes)) / safe
        total = jnp.maximum(self.count + new, 1.0)
        old_share, new_share = self.count / total, new / total
        gap = mean - self.mean
        merged = old_share * self.variance + new_share * variance + old_share * new_share * gap**2
        moved = ObservationStatistics(self.count + new, self.mean + new_share * gap, merged)
        return jax.tree.map(lambda old, now: jnp.where(new > 0, now, old), self, moved)


def no_observations(size: int) -> ObservationStatistics:
    """Return the statistics before any observation: they change nothing.

    Args:
        size: components of an observation.
    """
    return ObservationStatistics(jnp.zeros(()), jnp.zeros(size), jnp.full(size, 1.0 - EPSILON))
