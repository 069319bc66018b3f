"""Calibration of the 90 % intervals, by searches in tasks that the prior does not know."""

import dataclasses
from collections.abc import Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from maesn.axes import Key
from maesn.learners import AbstractSettableLatent, Purpose
from maesn.runtime.posterior import Reading
from maesn.runtime.return_model import NOMINAL, ReturnPrior
from maesn.runtime.search import SearchSettings
from maesn.search.learner import SearchFastLearner, SearchState
from maesn.worlds import AbstractWorld
from maesn.worlds.collector import Collector

EPISODES = 30  # of each task: by turns, two of a search, and one of the latent to deploy
# Fewer readings than this tell nothing of the tails; nor do readings that are all alike.
_FEWEST = 100
_OUTERMOST = 0.002  # a level: no number of readings shows that nothing lies beyond


def calibrated(
    prior: ReturnPrior, latent: AbstractSettableLatent, world: AbstractWorld, key: Key
) -> ReturnPrior:
    """Return the prior with the levels of its intervals, found by searches with default settings.

    If the model is right, the returns hit the quantiles of its predictions uniformly. If it is too
    wide or too narrow, the quantiles that they did hit correct it. The world has tasks that the
    prior does not know, with the reward of the new tasks.
    """
    settings = SearchSettings()
    learner = SearchFastLearner(latent, settings.model(prior), settings)
    collect = Collector(world, 1)
    places: dict[Purpose, list[float]] = {"explore": [], "deploy": []}
    keys, slots = jax.random.split(key, collect.num_tasks), jnp.arange(collect.num_tasks)
    for part in collect.parts(collect.num_tasks):
        state = learner.init(keys[part])
        for count in range(EPISODES):
            purpose: Purpose = "deploy" if count % 3 == 2 else "explore"
            episode_keys = jax.vmap(jax.random.fold_in, in_axes=(0, None))(keys[part], count)
            episodes = collect(episode_keys, learner.agents(state, purpose), slots[part])
            readings = learner.readings(state, episodes, purpose)
            places[purpose] += _places(state, readings)
            if purpose == "explore":
                state = learner.after(state, readings)
    proposed = _levels(places["explore"], NOMINAL)
    deployed = _levels(places["deploy"], proposed)
    return dataclasses.replace(prior, proposed_levels=proposed, deployed_levels=deployed)


def _places(state: SearchState, readings: Sequence[Sequence[Reading]]) -> Iterator[float]:
    """Yield where returns lie in what was predicted of them, unless they were known exactly."""
    for search, (reading,) in zip(state.searches, readings, strict=True):
        if not search.posterior.known[reading.point]:
            yield search.posterior.place(reading)


def _levels(places: Sequence[float], otherwise: Sequence[float]) -> tuple[float, float]:
    """Return the levels that 90 % of the places lie between; `otherwise` if they do not tell."""
    low, high = otherwise
    if len(places) >= _FEWEST:
        found = np.clip(np.quantile(places, NOMINAL), _OUTERMOST, 1.0 - _OUTERMOST).tolist()
        low, high = found if found[0] < found[1] else otherwise
    return low, high
