"""The fast learner that searches the latent space, by a model of the returns."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from maesn.axes import TaskKeys
from maesn.context import Latent
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import AbstractFastLearner, Purpose
from maesn.numerics.normalization import ObservationStatistics
from maesn.policies import AbstractPolicy
from maesn.runtime.return_model import Reading, ReturnModel
from maesn.runtime.search import LatentSearch, SearchSettings
from maesn.search.strategy_learner import task_generators


@dataclass(frozen=True)
class SearchState:
    """State of a `SearchFastLearner`, one element per task."""

    searches: tuple[LatentSearch, ...]
    chosen: tuple[int, ...]
    """The points to play next, indices into `LatentSearch.points`."""
    generators: tuple[np.random.Generator, ...]


class SearchFastLearner(AbstractFastLearner[SearchState]):
    """Plays the latent that the acquisition function chooses; deploys the best posterior mean."""

    policy: AbstractPolicy
    statistics: ObservationStatistics | None
    model: ReturnModel
    settings: SearchSettings

    def init(self, keys: TaskKeys) -> SearchState:
        generators = task_generators(keys)
        start = LatentSearch.start(self.model, self.settings)
        return _propose([start] * len(generators), generators)

    def agents(self, state: SearchState, purpose: Purpose = "explore") -> Agents:
        explores = purpose == "explore"
        context = _latents(state, state.chosen) if explores else self.adapted(state)
        return Agents(self.policy, context, shares_policy=True, statistics=self.statistics)

    def adapted(self, state: SearchState) -> Latent:
        """Return the latents to deploy."""
        return _latents(state, tuple(search.best for search in state.searches))

    def update(self, state: SearchState, episodes: Episodes) -> SearchState:
        returns = np.asarray(episodes.undiscounted_return, np.float64)
        lengths = np.asarray(episodes.valid.mean(-1), np.float64)
        searches = []
        for search, point, *per_episode in zip(
            state.searches, state.chosen, returns, lengths, strict=True
        ):
            readings = [Reading(point, *one) for one in zip(*per_episode, strict=True)]
            searches.append(search.after(readings))
        return _propose(searches, state.generators)


def _latents(state: SearchState, points: Sequence[int]) -> Latent:
    pairs = zip(state.searches, points, strict=True)
    return Latent.fixed(jnp.asarray([search.latent(point) for search, point in pairs], jnp.float32))


def _propose(
    searches: Sequence[LatentSearch], generators: Sequence[np.random.Generator]
) -> SearchState:
    """Return the state in which each search has chosen the point to play next."""
    own = copy.deepcopy(tuple(generators))  # those of the state before stay as they are
    proposed = [search.proposed(one) for search, one in zip(searches, own, strict=True)]
    # A search may have added the point that it proposes.
    searches_after, chosen = zip(*proposed, strict=True)
    return SearchState(searches_after, chosen, own)
