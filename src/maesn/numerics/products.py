"""Matrix products in full precision."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def multiply(left: Float[Array, "..."], right: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return `left @ right`, computed in single precision on every device.

    By default, graphics cards round the factors to 10 bits of mantissa (TF32). A policy that is
    asked again then answers differently by 1e-3, which is what a trust region has to measure.
    Derivatives of the product keep its precision. On a CPU it is the plain product, bit for bit.
    """
    return jnp.matmul(left, right, precision=jax.lax.Precision.HIGHEST)
