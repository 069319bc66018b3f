"""A ring buffer: the last rows of a stream, in arrays of fixed size."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

# Below this standard deviation a feature counts as constant: its scale is then 1, since a quotient
# of rounding errors would be of order 1 as well.
CONSTANT_STD = 1e-6


class Ring(eqx.Module):
    """A stream's last `capacity` rows; older ones are overwritten.

    It holds arrays alone, so it can be passed to compiled programs and saved, and its memory
    is bounded from the start.
    """

    rows: Any
    """A pytree of arrays `[*batch, capacity, ...]`. Row n of the stream is stored at n modulo the
    capacity; zeros where there is none yet."""
    count: Int[Array, "*batch"]
    """Number of rows that were ever added."""

    @staticmethod
    def empty(capacity: int, row: Any) -> "Ring":
        """Return a ring without rows; their shapes and types are those of `row`."""
        rows = jax.tree.map(lambda x: jnp.zeros((capacity, *x.shape), x.dtype), row)
        return Ring(rows, jnp.zeros((), int))

    @property
    def capacity(self) -> int:
        """Number of rows that fit."""
        return int(jax.tree.leaves(self.rows)[0].shape[self.count.ndim])

    @property
    def size(self) -> Int[Array, "*batch"]:
        """Number of rows in the ring."""
        return jnp.minimum(self.count, self.capacity)

    def extend(self, rows: Any, valid: Bool[Array, " row"]) -> "Ring":
        """Append the valid rows, in their order.

        Args:
            rows: the next rows of the stream.
            valid: where it is false, the row is skipped.
        """
        number = jnp.cumsum(valid) - 1  # of each valid row among the valid ones
        total = valid.sum()
        # Of more rows than fit, only the last are written: the order of writes to one index is
        # undefined.
        kept = valid & (number >= total - self.capacity)
        place = jnp.where(kept, (self.count + number) % self.capacity, self.capacity)
        written = jax.tree.map(lambda x, y: x.at[place].set(y, mode="drop"), self.rows, rows)
        return Ring(written, self.count + total)

    def sample(self, key: PRNGKeyArray, number: int) -> Any:
        """Draw rows uniformly, with replacement; zeros from an empty ring."""
        index = jax.random.randint(key, (number,), 0, jnp.maximum(self.size, 1))
        return jax.tree.map(lambda x: x[index], self.rows)

    def moments(self) -> tuple[Float[Array, " feature"], Float[Array, " feature"]]:
        """Return mean and standard deviation of each feature; 0 and 1 for an empty ring.

        A row is an array of features. A feature that is constant has the standard deviation 1.
        """
        held = (jnp.arange(self.capacity) < self.size)[:, None]
        number = jnp.maximum(self.size, 1).astype(self.rows.dtype)
        mean = jnp.where(held, self.rows, 0.0).sum(0) / number
        variance = jnp.where(held, (self.rows - mean[None]) ** 2, 0.0).sum(0) / number
        std = jnp.sqrt(variance)
        return mean, jnp.where(std > CONSTANT_STD, std, 1.0)
