"""Where the random draws of a collection come from."""

import jax
import jax.numpy as jnp

from maesn.axes import Key, TaskKeys


def task_keys(key: Key, phase: int, num_slots: int) -> TaskKeys:
    """Return one key per task slot, for one of the collections of a meta-iteration."""
    phase_key = jax.random.fold_in(key, phase)
    return jax.vmap(jax.random.fold_in, in_axes=(None, 0))(phase_key, jnp.arange(num_slots))
