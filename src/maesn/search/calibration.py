"""Intervals that hold what they say: their levels, from searches in tasks that the prior lacks."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from maesn.axes import Key
from maesn.learners import AbstractSettableLatent
from maesn.runtime.return_model import NOMINAL, ReturnPrior
from maesn.runtime.search_settings import SearchSettings
from maesn.search.learner import SearchFastLearner
from maesn.worlds import AbstractWorld
from maesn.worlds.collector import Collector

EPISODES = 20  # of a search
# Fewer readings than this tell nothing of the tails.
_FEWEST = 100
_OUTERMOST = 0.002  # a level: no number of readings shows that nothing lies beyond


def calibrated(
    prior: ReturnPrior, latent: AbstractSettableLatent, world: AbstractWorld, key: Key
) -> ReturnPrior:
    """Search in new tasks, and return the prior with the levels of its intervals.

    A right model sees the quantiles of its predictions hit uniformly. One that is too wide or too
    narrow is corrected by the quantiles that were hit.

    Args:
        prior: returns of an archive.
        latent: the latent of the run's learner.
        world: tasks that the prior does not know, with the reward of the new tasks.
        key: random key of the searches.
    """
    settings = SearchSettings()
    model = settings.model(dataclasses.replace(prior, proposed_levels=NOMINAL))
    learner = SearchFastLearner(latent, model, settings)
    collect = Collector(world, 1)
    proposed: list[float] = []
    deployed: list[float] = []
    keys, slots = jax.random.split(key, collect.num_tasks), jnp.arange(collect.num_tasks)
    for part in collect.parts(collect.num_tasks):
        state = learner.init(keys[part])
        for episode in range(EPISODES):
            episode_keys = jax.vmap(jax.random.fold_in, in_axes=(0, None))(keys[part], episode)
            after = learner.update(state, collect(episode_keys, learner.agents(state), slots[part]))
            for search, later in zip(state.searches, after.searches, strict=True):
                reading = later.posterior.readings[-1]
                place = search.posterior.place(reading)
                proposed.append(place)
                if reading.point == search.best:
                    deployed.append(place)
            state = after
    levels = _levels(proposed, NOMINAL)
    return dataclasses.replace(
        prior, proposed_levels=levels, deployed_levels=_levels(deployed, levels)
    )


def _levels(places: Sequence[float], otherwise: Sequence[float]) -> tuple[float, float]:
    if len(places) < _FEWEST:
        low, high = otherwise
        return low, high
    low, high = np.clip(np.quantile(places, NOMINAL), _OUTERMOST, 1.0 - _OUTERMOST).tolist()
    return low, high
