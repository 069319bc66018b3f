"""The archive: the latents that a search chooses from."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from maesn.axes import Key
from maesn.context import Latent
from maesn.experience.agent import Agents
from maesn.learners import AbstractFastLearner, GradientFastLearner
from maesn.worlds.collector import Collector


def latent_learner(learner: AbstractFastLearner[Any]) -> GradientFastLearner:
    """Return the learner, checked to have a latent.

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


def holding(learner: GradientFastLearner, latents: np.ndarray) -> Agents:
    """Return agents with the learner's policy, each of which holds one of the latents."""
    context = Latent.fixed(jnp.asarray(latents, jnp.float32))
    return Agents(learner.policy, context, shares_policy=True, statistics=learner.statistics)


def adapted_latents(learner: GradientFastLearner, collect: Collector, key: Key) -> np.ndarray:
    """Return the mean of each training task's latent after one more update, `[task, z]`.

    Args:
        learner: the run's learner.
        collect: plays the training tasks, with their dense reward.
        key: random key of the episodes.
    """
    keys = jax.random.split(key, collect.num_tasks)
    means = []
    for part in collect.parts(collect.num_tasks):
        slots = jnp.arange(collect.num_tasks)[part]
        # Start from the trained latents instead of the prior.
        trained = jax.tree.map(lambda x, slots=slots: x[slots], learner.context_table)
        state = learner.init(keys[slots])
        state = eqx.tree_at(lambda state: state.agents.context, state, trained)
        episodes = collect(keys[slots], learner.agents(state), slots)
        adapted = learner.update(state, episodes).agents.context
        assert isinstance(adapted, Latent)
        means.append(np.asarray(adapted.mean, np.float64))
    return np.concatenate(means)
