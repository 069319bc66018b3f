"""Normalisation of observations by the mean and variance of all observations in training.

The statistics are constant during a meta-iteration: no gradient runs through them. At its end they
are updated with the observations of its episodes. In a new task they are frozen, because the policy
has learned to adapt under fixed statistics.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.numerics import mesh

# Added to the variance, as in Gymnasium's `NormalizeObservation`, so that a component that never
# changes is not divided by 0.
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
        """sqrt(variance + epsilon), the divisor."""
        return jnp.sqrt(self.variance + EPSILON)

    def with_batch(
        self, observation: Float[Array, "*batch observation"], valid: Bool[Array, "*batch"]
    ) -> "ObservationStatistics":
        """Return the statistics after a batch, by a numerically stable update.

        With count n, mean m and variance v before, n', m' and v' of the batch, N = n + n' and
        d = m' - m,

            mean = m + d n' / N,  variance = (n v + n' v') / N + d^2 n n' / N^2

        (Chan, Golub and LeVeque 1979, "Updating formulae and a pairwise algorithm").

        Args:
            observation: a batch of any shape; where devices share the tasks, this device's part.
            valid: which observations count; the others may be anything.
        """
        axes, mask = tuple(range(valid.ndim)), valid[..., None]
        new_count = mesh.total(valid.sum()).astype(float)
        divisor = jnp.maximum(new_count, 1.0)
        mean = mesh.total(jnp.where(mask, observation, 0.0).sum(axes)) / divisor
        centred = jnp.where(mask, observation - jnp.broadcast_to(mean, observation.shape), 0.0)
        variance = mesh.total((centred**2).sum(axes)) / divisor
        total = jnp.maximum(self.count + new_count, 1.0)
        old_share, new_share = self.count / total, new_count / total
        gap = mean - self.mean
        merged = ObservationStatistics(
            count=self.count + new_count,
            mean=self.mean + new_share * gap,
            variance=old_share * self.variance
            + new_share * variance
            + old_share * new_share * gap**2,
        )
        return jax.tree.map(lambda old, new: jnp.where(new_count > 0, new, old), self, merged)


def no_observations(size: int) -> ObservationStatistics:
    """Return the statistics before any observation, under which `normalized` is the identity."""
    variance = jnp.full(size, 1.0 - EPSILON, float)
    return ObservationStatistics(jnp.zeros(()), jnp.zeros(size), variance)
