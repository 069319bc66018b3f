"""One step of an optimiser from Optax."""

from typing import TypeVar

import jax
import optax

Parameters = TypeVar("Parameters")


def first_order_step(
    optimizer: optax.GradientTransformation,
    parameters: Parameters,
    gradient: Parameters,
    memory: optax.OptState,
) -> tuple[Parameters, optax.OptState]:
    """Return moved parameters, and what the optimiser remembers of the step.

    Args:
        optimizer: from Optax.
        parameters: where to start.
        gradient: of what is minimised.
        memory: of the steps before; `optimizer.init(parameters)` at first.
    """
    # Optax raises floats to integer powers, which strict promotion refuses.
    with jax.numpy_dtype_promotion("standard"):
        change, memory = optimizer.update(gradient, memory, parameters)
        moved = optax.apply_updates(parameters, change)
    return moved, memory
