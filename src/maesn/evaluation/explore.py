"""Record how an agent explores, for the paper's figures 6 and 8."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from maesn.axes import TaskKeys
from maesn.context import Latent
from maesn.experience.agent import Agents
from maesn.learners import AbstractFastLearner
from maesn.worlds.collector import Collector

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


def explore(
    learner: AbstractFastLearner[Any], collect: Collector, num_tasks: int = 1, seed: int = 0
) -> Exploration:
    """Play from the start in new tasks, once drawing z and once holding it fixed.

    Args:
        learner: the fast learner of a trained or untrained policy.
        collect: a world. Of each of its tasks that is played it plays `episodes_per_task`.
        num_tasks: the first so many tasks of the world are played, the same ones in both cases;
            from the first one again if there are not as many. One is enough if all tasks look the
            same to the agent. If it sees what differs (how a table is laid, or an instruction),
            each shows a part of what it does.
        seed: of the episodes.
    """
    keys = jax.random.split(jax.random.key(seed), num_tasks)
    state = learner.init(keys)
    agents = learner.agents(state)
    paths, latents = _play(agents, collect, keys)
    if not isinstance(agents.context, Latent):
        return Exploration(paths, latents, None)
    fixed = learner.agents(state, "deploy")
    return Exploration(paths, latents, _play(fixed, collect, keys)[0])


def _play(agents: Agents, collect: Collector, keys: TaskKeys) -> tuple[Paths, Any]:
    """Return the paths and the latents of all episodes, task by task."""
    episodes = collect(keys, agents, jnp.arange(len(keys)) % collect.num_tasks)
    position = jax.vmap(jax.vmap(jax.vmap(collect.world.env.position)))(episodes.observation)
    paths = jax.vmap(jax.vmap(_stay))(position, episodes.valid)
    return np.concatenate(paths), np.concatenate(episodes.z)


def _stay(
    path: Float[Array, "time_plus_1 2"], valid: Bool[Array, " time"]
) -> Float[Array, "time_plus_1 2"]:
    """Let a path end where its episode does: what comes later is garbage.

    A state that ends the episode because it blew up is no place: the path ends a step earlier.
    """
    last = valid.sum()
    last = jnp.where(jnp.isfinite(path[last]).all(), last, jnp.maximum(last - 1, 0))
    return path[jnp.minimum(jnp.arange(len(path)), last)]
