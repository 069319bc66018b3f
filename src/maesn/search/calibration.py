"""Intervals that hold what they say: their levels, from searches in tasks that the prior lacks."""

import dataclasses
from collections.abc import Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from maesn.axes import Key
from maesn.experience.episodes import Episodes
from maesn.learners import AbstractSettableLatent, Purpose
from maesn.runtime.posterior import Reading
from maesn.runtime.return_model import NOMINAL, ReturnPrior
from maesn.runtime.search_settings import SearchSettings
from maesn.search.learner import SearchFastLearner, SearchState
from maesn.worlds import AbstractWorld
from maesn.worlds.collector import Collector

EPISODES = 30  # of each task: by turns, two of a search, and one of the latent to deploy
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
    places: dict[Purpose, list[float]] = {"explore": [], "deploy": []}
    keys, slots = jax.random.split(key, collect.num_tasks), jnp.arange(collect.num_tasks)
    for part in collect.parts(collect.num_tasks):
        state = learner.init(keys[part])
        for count in range(EPISODES):
            purpose: Purpose = "deploy" if count % 3 == 2 else "explore"
            episode_keys = jax.vmap(jax.random.fold_in, in_axes=(0, None))(keys[part], count)
            episodes = collect(episode_keys, learner.agents(state, purpose), slots[part])
            places[purpose] += _places(state, episodes, purpose)
            if purpose == "explore":
                state = learner.update(state, episodes)
    proposed = _levels(places["explore"], NOMINAL)
    deployed = _levels(places["deploy"], proposed)
    return dataclasses.replace(prior, proposed_levels=proposed, deployed_levels=deployed)


def _places(state: SearchState, episodes: Episodes, purpose: Purpose) -> Iterator[float]:
    """Yield where returns lie in what was predicted of them, unless they were known exactly."""
    returns = np.asarray(episodes.undiscounted_return[:, 0], np.float64)
    lengths = np.asarray(episodes.valid[:, 0].mean(-1), np.float64)
    for search, (proposed,), *played in zip(
        state.searches, state.chosen, returns, lengths, strict=True
    ):
        point = search.best if purpose == "deploy" else proposed
        if not search.posterior.is_known(point):
            yield search.posterior.place(Reading(point, *played))


def _levels(places: Sequence[float], otherwise: Sequence[float]) -> tuple[float, float]:
    if len(places) < _FEWEST:
        low, high = otherwise
        return low, high
    low, high = np.clip(np.quantile(places, NOMINAL), _OUTERMOST, 1.0 - _OUTERMOST).tolist()
    return low, high
