"""The fast learner that searches: one latent per episode, chosen by what is known so far."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from maesn.axes import TaskKeys
from maesn.context import Latent
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import AbstractFastLearner, Purpose, SavedContexts
from maesn.learners.base import refuse_saved
from maesn.numerics.normalization import ObservationStatistics
from maesn.policies import AbstractPolicy
from maesn.runtime.return_model import Reading, ReturnModel
from maesn.runtime.search import LatentSearch, SearchSettings
from maesn.search.strategy_learner import task_generators


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
        generators = task_generators(keys)
        start = LatentSearch.start(self.model, self.settings)
        return self._next([start] * len(generators), generators)

    def agents(self, state: SearchState, purpose: Purpose = "explore") -> Agents:
        deployed = tuple(search.best for search in state.searches)
        context = self._latents(state, state.chosen if purpose == "explore" else deployed)
        return Agents(
            self.policy, context.at_mean(), shares_policy=True, statistics=self.statistics
        )

    def adapted(self, state: SearchState) -> Latent:
        """Return the latents that would be deployed."""
        return self._latents(state, tuple(search.best for search in state.searches))

    def update(self, state: SearchState, episodes: Episodes) -> SearchState:
        returns = np.asarray(episodes.undiscounted_return, np.float64)
        lengths = np.asarray(episodes.valid.mean(-1), np.float64)
        searches = []
        for search, point, *played in zip(
            state.searches, state.chosen, returns, lengths, strict=True
        ):
            readings = [Reading(point, *one) for one in zip(*played, strict=True)]
            searches.append(search.after(readings))
        return self._next(searches, state.generators)

    def _latents(self, state: SearchState, points: Sequence[int]) -> Latent:
        pairs = zip(state.searches, points, strict=True)
        mean = jnp.asarray([search.latent(point) for search, point in pairs], jnp.float32)
        return Latent(mean, jnp.zeros_like(mean))

    def _next(
        self, searches: Sequence[LatentSearch], generators: Sequence[np.random.Generator]
    ) -> SearchState:
        pairs = zip(searches, generators, strict=True)
        proposed = [search.proposed(generator) for search, generator in pairs]
        found, chosen = zip(*proposed, strict=True)
        return SearchState(found, chosen, tuple(generators))
