"""The fast learner that searches the latent space, by a model of the returns."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np

from maesn.axes import TaskKeys
from maesn.context import AbstractContext
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import AbstractFastLearner, AbstractSettableLatent, Purpose
from maesn.runtime.return_model import Reading, ReturnModel
from maesn.runtime.search import LatentSearch, SearchSettings


@dataclass(frozen=True)
class SearchState:
    """State of a `SearchFastLearner`, one element per task."""

    searches: tuple[LatentSearch, ...]
    chosen: tuple[int, ...]
    """The points to play next, indices into `LatentSearch.points`."""
    generators: tuple[np.random.Generator, ...]


class SearchFastLearner(AbstractFastLearner[SearchState]):
    """Plays the latent that the acquisition function chooses; deploys the best posterior mean."""

    steered: AbstractSettableLatent
    """The latent that the search chooses."""
    model: ReturnModel
    settings: SearchSettings

    def init(self, keys: TaskKeys) -> SearchState:
        seeds = np.asarray(jax.vmap(jax.random.key_data)(keys))
        generators = [np.random.default_rng(seed.tolist()) for seed in seeds]
        start = LatentSearch.start(self.model, self.settings)
        return _propose([start] * len(generators), generators)

    def agents(self, state: SearchState, purpose: Purpose = "explore") -> Agents:
        explores = purpose == "explore"
        return self._holding(state, state.chosen if explores else _best(state))

    def adapted(self, state: SearchState) -> AbstractContext:
        """Return the latents to deploy."""
        return self._holding(state, _best(state)).context

    def _holding(self, state: SearchState, points: Sequence[int]) -> Agents:
        pairs = zip(state.searches, points, strict=True)
        latents = [search.latent(point) for search, point in pairs]
        # The latents explore, so the actions need no noise.
        return replace(self.steered.holding(np.asarray(latents, np.float32)), is_noisy=False)

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


def _best(state: SearchState) -> tuple[int, ...]:
    return tuple(search.best for search in state.searches)


def _propose(
    searches: Sequence[LatentSearch], generators: Sequence[np.random.Generator]
) -> SearchState:
    """Return the state in which each search has chosen the point to play next."""
    own = copy.deepcopy(tuple(generators))  # those of the state before stay as they are
    proposed = [search.proposed(one) for search, one in zip(searches, own, strict=True)]
    # A search may have added the point that it proposes.
    searches_after, chosen = zip(*proposed, strict=True)
    return SearchState(searches_after, chosen, own)
