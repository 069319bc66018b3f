"""The tasks of a meta-iteration, and where the random draws of a collection come from."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from maesn.axes import Key, TaskKeys


def check_enough_tasks(num_tasks: int, wanted: int, setting: str = "meta_batch_size") -> None:
    """Refuse by ValueError a training set with fewer tasks than a setting wants to draw at once."""
    if num_tasks < wanted:
        raise ValueError(
            f"`{setting}` is {wanted}, but the training set holds only {num_tasks} tasks. Tasks "
            "are drawn without replacement: lower it or add tasks."
        )


def draw_tasks(key: Key, num_tasks: int, meta_batch_size: int) -> Int[Array, " task"]:
    """Draw the training tasks of one meta-iteration, all of them different."""
    return jax.random.choice(key, num_tasks, (meta_batch_size,), replace=False)


@partial(jax.jit, static_argnames=("phase", "meta_batch_size"))
def task_keys(key: Key, phase: int, meta_batch_size: int) -> TaskKeys:
    """Return one key per task slot, for one collection of a meta-iteration."""
    phase_key = jax.random.fold_in(key, phase)
    return jax.vmap(jax.random.fold_in, in_axes=(None, 0))(phase_key, jnp.arange(meta_batch_size))
