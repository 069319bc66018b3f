"""Record how an agent explores, for the paper's figures 6 and 8."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from maesn.agent import Agents
from maesn.context import Latent
from maesn.learners import GradientFastLearner
from maesn.rollout import Collector

# Standard deviation of a latent that is held fixed: small enough not to matter, and its
# logarithm is finite.
FIXED_STD = 1e-6

Paths = Float[np.ndarray, "episode time_plus_1 2"]


class Exploration(NamedTuple):
    """Planar paths of an agent that has not learned anything about its task yet, in metres."""

    prior_paths: Paths
    """z drawn from the prior in every episode."""
    prior_latents: Float[np.ndarray, "episode context"]
    """The z of those episodes."""
    fixed_paths: Paths | None
    """z held at the prior's mean, so that only the noise of the actions is left; None for a
    method without a latent."""


def explore(learner: GradientFastLearner, collect: Collector, seed: int = 0) -> Exploration:
    """Play from the start in new tasks, once drawing z and once holding it fixed.

    Args:
        learner: the fast learner of a trained or untrained policy.
        collect: a world; only its first task is played. Observations do not contain the task, so
            which one it is makes no difference to where the agent goes.
        seed: of the episodes.
    """
    agents = learner.agents(learner.init(1))
    paths, latents = _play(agents, collect, seed)
    if not isinstance(agents.context, Latent):
        return Exploration(paths, latents, None)
    fixed = Latent(agents.context.mean, jnp.full_like(agents.context.mean, np.log(FIXED_STD)))
    fixed_agents = Agents(agents.policy, fixed, agents.shares_policy)
    return Exploration(paths, latents, _play(fixed_agents, collect, seed)[0])


def _play(agents: Agents, collect: Collector, seed: int) -> tuple[Paths, Any]:
    keys = jax.random.split(jax.random.key(seed), 1)
    episodes = collect(keys, agents, jnp.zeros(1, int))
    position = jax.vmap(jax.vmap(collect.world.env.position))(episodes.observation[0])
    return np.asarray(position), np.asarray(episodes.context[0])
