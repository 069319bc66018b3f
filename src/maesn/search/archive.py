"""The archive of latents that a search chooses from."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from maesn.axes import Key
from maesn.context import Latent
from maesn.experience.episodes import Collect
from maesn.learners import AbstractFastLearner, GradientFastLearner


def latent_learner(learner: AbstractFastLearner[Any]) -> GradientFastLearner:
    """Return a learner if it has a latent to search for.

    Raises:
        ValueError: it has none.
    """
    if not isinstance(learner, GradientFastLearner) or not isinstance(
        learner.context_table, Latent
    ):
        raise ValueError(
            "a search needs a policy with a latent, as that of `maesn`, `maesn_theta` or "
            f"`latent_space`, but this method has a `{type(learner).__name__}` without one."
        )
    return learner


def drawn_latents(size: int, number: int, spread: float, seed: int) -> np.ndarray:
    """Draw latents from the widened prior N(0, spread^2 I), `[latent, z]`."""
    return spread * np.random.default_rng(seed).standard_normal((number, size))


def adapted_latents(learner: GradientFastLearner, collect: Collect, key: Key) -> np.ndarray:
    """Return the means that one update reaches from each training task's own latent, `[task, z]`.

    Args:
        learner: of the run.
        collect: plays the training tasks, with their dense reward.
        key: of the episodes.
    """
    count = collect.num_tasks
    keys = jax.random.split(key, count)
    state = eqx.tree_at(
        lambda state: state.agents.context, learner.init(keys), learner.context_table
    )
    episodes = collect(keys, learner.agents(state), jnp.arange(count))
    adapted = learner.update(state, episodes).agents.context
    assert isinstance(adapted, Latent)
    return np.asarray(adapted.mean, np.float64)
