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
    """Return the parameters and the optimiser's state after one step.

    Args:
        optimizer: an optimiser of Optax.
        parameters: the parameters before the step.
        gradient: gradient of the loss.
        opt_state: state of the optimiser; `optimizer.init(parameters)` at first.
    """
    # Optax raises floats to integer powers, which strict promotion refuses.
    with jax.numpy_dtype_promotion("standard"):
        change, opt_state = optimizer.update(gradient, opt_state, parameters)
        moved = optax.apply_updates(parameters, change)
    return moved, opt_state


def if_finite(new: Improved, old: Improved) -> tuple[Improved, Bool[Array, ""]]:
    """Return `new` if all of its numbers are finite, else `old`; and whether it was `new`.

    Args:
        new: a pytree of arrays.
        old: another one of the same shapes.
    """
    finite = [jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(new)]
    accepted = jnp.stack(finite).all()
    return jax.tree.map(lambda one, other: jnp.where(accepted, one, other), new, old), accepted
