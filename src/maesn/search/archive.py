"""The archive: the latents that a search chooses from."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from maesn.axes import Key
from maesn.learners import AbstractFastLearner, AbstractSettableLatent
from maesn.worlds.collector import Collector


def latent_of(learner: AbstractFastLearner[Any]) -> AbstractSettableLatent:
    """Return the latent of a learner that has one; raise a `ValueError` if it has none."""
    if learner.latent is None:
        raise ValueError(
            "a search needs a policy with a latent, as that of `maesn`, `maesn_theta` or "
            f"`latent_space`, but this method has a `{type(learner).__name__}` without one."
        )
    return learner.latent


def drawn_latents(size: int, number: int, spread: float, seed: int) -> np.ndarray:
    """Draw latents from the widened prior N(0, spread^2 I), `[latent, z]`."""
    return spread * np.random.default_rng(seed).standard_normal((number, size))


def adapted_latents(latent: AbstractSettableLatent, collect: Collector, key: Key) -> np.ndarray:
    """Return a latent of each training task, `[task, z]`, found with their dense reward."""
    keys, slots = jax.random.split(key, collect.num_tasks), jnp.arange(collect.num_tasks)
    parts = collect.parts(collect.num_tasks)
    return np.concatenate([latent.of_tasks(collect, keys[part], slots[part]) for part in parts])
