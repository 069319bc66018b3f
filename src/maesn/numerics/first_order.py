"""One step of an optimiser from Optax, and what to do with steps that are not finite."""

from typing import TypeVar

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool

Parameters = TypeVar("Parameters")
Improved = TypeVar("Improved")


def first_order_step(
    optimizer: optax.GradientTransformation,
    parameters: Parameters,
    gradient: Parameters,
    opt_state: optax.OptState,
) -> tuple[Parameters, optax.OptState]:
    """Return parameters and state of the optimiser after a step down the gradient of a loss.

    The first state is `optimizer.init(parameters)`.
    """
    # Optax raises floats to integer powers, which strict promotion refuses.
    with jax.numpy_dtype_promotion("standard"):
        change, opt_state = optimizer.update(gradient, opt_state, parameters)
        moved = optax.apply_updates(parameters, change)
    return moved, opt_state


def if_finite(new: Improved, old: Improved) -> tuple[Improved, Bool[Array, ""]]:
    """Return `new`, if all of its arrays are finite, else `old`; and whether it was `new`."""
    finite = [jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(new)]
    accepted = jnp.stack(finite).all()
    return jax.tree.map(lambda one, other: jnp.where(accepted, one, other), new, old), accepted
