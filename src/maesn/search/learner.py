"""The fast learner that searches the latent space, by a model of the returns."""

import copy
import itertools
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from maesn.axes import TaskKeys
from maesn.context import AbstractContext
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import AbstractFastLearner, AbstractSettableLatent, Purpose
from maesn.runtime.posterior import Reading
from maesn.runtime.return_model import ReturnModel
from maesn.runtime.search import LatentSearch, SearchSettings

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class SearchState:
    """State of a `SearchFastLearner`, one element per task."""

    searches: tuple[LatentSearch, ...]
    chosen: tuple[tuple[int, ...], ...]
    """The points to play next at the same time, indices into `LatentSearch.points`."""
    generators: tuple[np.random.Generator, ...]


def latent_of(learner: AbstractFastLearner[Any]) -> AbstractSettableLatent:
    """Return the latent of a learner that has one; raise a `ValueError` if it has none."""
    if learner.latent is None:
        raise ValueError(
            "a search needs a policy with a latent, as that of `maesn`, `latent_space` or `pearl`, "
            f"but this method has a `{type(learner).__name__}` without one."
        )
    return learner.latent


class SearchFastLearner(AbstractFastLearner[SearchState]):
    """Plays the latents that the acquisition function chooses; deploys the best posterior mean."""

    steered: AbstractSettableLatent
    """The latent that the search chooses."""
    model: ReturnModel
    settings: SearchSettings
    at_once: int = 1
    """Latents that are played in a task at the same time; an update reads one episode of each."""

    def init(self, keys: TaskKeys) -> SearchState:
        seeds = np.asarray(jax.vmap(jax.random.key_data)(keys))
        generators = [np.random.default_rng(seed.tolist()) for seed in seeds]
        start = LatentSearch.start(self.model, self.settings)
        return self._propose([start] * len(generators), generators)

    def agents(self, state: SearchState, purpose: Purpose = "explore") -> Agents:
        if purpose == "deploy" or self.at_once == 1:
            points = _best(state) if purpose == "deploy" else [one for (one,) in state.chosen]
            return self._holding(state, points)
        return self._holding(state, [list(points) for points in state.chosen])

    def adapted(self, state: SearchState) -> AbstractContext:
        """Return the latents to deploy."""
        return self._holding(state, _best(state)).context

    def _holding(self, state: SearchState, points: Sequence[int | list[int]]) -> Agents:
        pairs = zip(state.searches, points, strict=True)
        latents = [search.points[point] for search, point in pairs]
        # The latents explore, so the actions need no noise.
        return replace(self.steered.holding(np.asarray(latents, np.float32)), is_noisy=False)

    def update(self, state: SearchState, episodes: Episodes) -> SearchState:
        readings = self.readings(state, episodes)
        pairs = zip(state.searches, readings, strict=True)
        complaints = list(filter(None, (search.complaint(some) for search, some in pairs)))
        if complaints and not any(search.is_surprised for search in state.searches):
            tasks = len(state.searches)
            logger.warning("In %d of %d tasks, %s", len(complaints), tasks, complaints[0])
        return self.after(state, readings)

    def readings(
        self, state: SearchState, episodes: Episodes, purpose: Purpose = "explore"
    ) -> list[list[Reading]]:
        """Return what episodes tell that were played for a purpose, in each task."""
        returns = np.asarray(episodes.undiscounted_return, np.float64)
        lengths = np.asarray(episodes.valid.mean(-1), np.float64)
        points = [(best,) for best in _best(state)] if purpose == "deploy" else state.chosen
        return [
            list(map(Reading, itertools.cycle(some), *per_episode))
            for some, *per_episode in zip(points, returns, lengths, strict=True)
        ]

    def after(self, state: SearchState, readings: Sequence[Sequence[Reading]]) -> SearchState:
        """Return the state after some readings in each task."""
        pairs = zip(state.searches, readings, strict=True)
        return self._propose([search.after(some) for search, some in pairs], state.generators)

    def _propose(
        self, searches: Sequence[LatentSearch], generators: Sequence[np.random.Generator]
    ) -> SearchState:
        own = copy.deepcopy(tuple(generators))  # those of the state before stay as they are
        pairs = zip(searches, own, strict=True)
        # A search may have added points that it proposes.
        proposed = [search.proposed_together(one, self.at_once) for search, one in pairs]
        searches_after, chosen = zip(*proposed, strict=True)
        return SearchState(searches_after, chosen, own)


def _best(state: SearchState) -> tuple[int, ...]:
    return tuple(search.best for search in state.searches)
