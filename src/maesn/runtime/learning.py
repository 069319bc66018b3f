"""One update of the latent from a batch of episodes, with its safeguards."""

import warnings
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from maesn.runtime.baseline import episode_advantages
from maesn.runtime.latent import Latent, LearningRule
from maesn.runtime.safeguards import Safeguards
from maesn.runtime.search import LatentSearch
from maesn.runtime.state import ExplorerState

# One episode has no other to be better or worse than: its standardised advantage is 0.
MINIMUM_EPISODES = 2


class AdaptationInfo(NamedTuple):
    """The outcome of a call of `Explorer.adapt`."""

    mean_return: float
    """Mean undiscounted return of the batch."""
    num_episodes: int
    """Number of episodes in the batch, without those played with `explore=False`."""
    shortened: bool
    """Whether `max_latent_norm` shortened the update."""


def learned(
    state: ExplorerState, rule: LearningRule, safeguards: Safeguards, horizon: int = 1
) -> tuple[ExplorerState, AdaptationInfo]:
    """Return the state after an update from its episodes, which it no longer holds.

    A search needs the steps of a full episode, and warns once of returns that its prior cannot
    explain. RuntimeError says that there are too few episodes, or that the update is not finite.
    """
    if state.search is not None:
        return _after_search(state, state.search, horizon)
    num_episodes = len(state.episodes)
    _refuse_fewer(MINIMUM_EPISODES, num_episodes)
    mean_return = float(np.mean([episode.undiscounted_return for episode in state.episodes]))
    stepped = _policy_gradient_step(state, rule)
    bound = safeguards.max_latent_norm
    latent = stepped if bound is None else stepped.within(bound)
    info = AdaptationInfo(mean_return, num_episodes, shortened=latent is not stepped)
    return ExplorerState(latent, state.update + 1), info


def _after_search(
    state: ExplorerState, search: LatentSearch, horizon: int
) -> tuple[ExplorerState, AdaptationInfo]:
    """Return the state after an update of the search; its latent is the one to deploy."""
    readings = state.readings(horizon)
    _refuse_fewer(1, len(readings))
    if not search.is_surprised and (complaint := search.complaint(readings)):
        # At the line that calls `Explorer.adapt`, which calls `learned`, which calls this.
        warnings.warn(complaint, stacklevel=4)
    search = search.after(readings)
    latent = replace(state.latent, mean=search.points[search.best])
    mean_return = float(np.mean([one.episode_return for one in readings]))
    info = AdaptationInfo(mean_return, len(readings), shortened=False)
    return ExplorerState(latent, state.update + 1, search=search), info


def _refuse_fewer(needed: int, found: int) -> None:
    if found < needed:
        raise RuntimeError(
            f"`adapt` needs at least {needed} finished episodes to learn from, got {found}; play "
            "more with `begin_episode()`. Episodes that began with `explore=False` are not learned "
            "from."
        )


def _policy_gradient_step(state: ExplorerState, rule: LearningRule) -> Latent:
    advantage = episode_advantages(
        [episode.observations for episode in state.episodes],
        [episode.rewards for episode in state.episodes],
        rule.discount,
        rule.ridge,
    )
    drawn = np.stack([episode.latent for episode in state.episodes])
    try:
        return rule.step(state.latent, drawn, advantage, state.update)
    except ValueError as error:
        raise RuntimeError(
            f"the update of the latent is not finite, or too large: {error} The latent before and "
            f"the {len(state.episodes)} episodes are kept."
        ) from error
