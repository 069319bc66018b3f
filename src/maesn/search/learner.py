"""The fast learner that searches: one latent per episode, chosen by what is known so far."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from maesn.axes import TaskKeys
from maesn.context import Latent
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import AbstractFastLearner, Capabilities, Purpose, SavedContexts
from maesn.learners.base import refuse_saved
from maesn.numerics.normalization import ObservationStatistics
from maesn.policies import AbstractPolicy
from maesn.runtime.return_model import Reading, ReturnModel
from maesn.runtime.search import LatentSearch, SearchSettings


@dataclass(frozen=True)
class SearchState:
    """Of all tasks: the searches, what each plays next, and its random numbers."""

    searches: tuple[LatentSearch, ...]
    chosen: tuple[int, ...]
    generators: tuple[np.random.Generator, ...]


class SearchFastLearner(AbstractFastLearner[SearchState]):
    """Plays the latent that the acquisition chooses; deploys that of the highest posterior mean."""

    policy: AbstractPolicy
    statistics: ObservationStatistics | None
    model: ReturnModel
    settings: SearchSettings

    def init(self, keys: TaskKeys, saved: SavedContexts | None = None) -> SearchState:
        refuse_saved(self, saved)
        words = np.asarray(jax.vmap(jax.random.key_data)(keys))
        generators = tuple(np.random.default_rng(row.tolist()) for row in words)
        start = LatentSearch.start(self.model, self.settings)
        return self._next([start] * len(generators), generators)

    def agents(self, state: SearchState, purpose: Purpose = "explore") -> Agents:
        pairs = zip(state.searches, state.chosen, strict=True)
        latents = [
            search.latent(chosen if purpose == "explore" else search.best)
            for search, chosen in pairs
        ]
        mean = jnp.asarray(np.stack(latents), jnp.float32)
        context = Latent(mean, jnp.zeros_like(mean)).at_mean()
        return Agents(self.policy, context, shares_policy=True, statistics=self.statistics)

    def update(self, state: SearchState, episodes: Episodes) -> SearchState:
        returns = np.asarray(episodes.undiscounted_return, np.float64)
        lengths = np.asarray(episodes.valid.mean(-1), np.float64)
        searches = []
        for task, search in enumerate(state.searches):
            for value, length in zip(returns[task], lengths[task], strict=True):
                search = search.observed(Reading(state.chosen[task], float(value), float(length)))
            searches.append(search)
        return self._next(searches, state.generators)

    @property
    def capabilities(self) -> Capabilities:
        return Capabilities()

    def _next(self, searches: Any, generators: Any) -> SearchState:
        proposed = [one.proposed(g) for one, g in zip(searches, generators, strict=True)]
        return SearchState(
            tuple(search for search, _ in proposed),
            tuple(chosen for _, chosen in proposed),
            generators,
        )
