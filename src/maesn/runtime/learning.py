"""One update of the latent from a batch of episodes, with its safeguards."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from maesn.runtime.baseline import episode_advantages
from maesn.runtime.latent import Latent, LearningRule
from maesn.runtime.return_model import Reading
from maesn.runtime.safeguards import Safeguards
from maesn.runtime.search import LatentSearch
from maesn.runtime.state import ExplorerState, Undo

# One episode has no other to be better or worse than: its standardised advantage is 0.
MINIMUM_EPISODES = 2


class AdaptationInfo(NamedTuple):
    """What a call of `Explorer.adapt` did."""

    mean_return: float
    """Mean undiscounted return of the batch."""
    num_episodes: int
    """Number of episodes in the batch, without those played with `explore=False`."""
    rolled_back: bool
    """Whether the update before was taken back, instead of a new one being made."""
    shortened: bool
    """Whether `max_latent_norm` held the latent back."""


def learned(
    state: ExplorerState, rule: LearningRule, safeguards: Safeguards, horizon: int = 1
) -> tuple[ExplorerState, AdaptationInfo]:
    """Return the state after an update, without the episodes that led to it.

    Args:
        state: with the episodes to learn from, and none running.
        rule: how they move the latent.
        safeguards: bound on the latent, and when to take the last update back.
        horizon: steps of an episode of full length, for a search.

    Raises:
        RuntimeError: too few episodes, or the update is not finite.
    """
    num_episodes = len(state.episodes)
    needed = MINIMUM_EPISODES if state.search is None else 1
    if num_episodes < needed:
        raise RuntimeError(
            f"`adapt` needs at least {needed} finished episodes to learn from, got "
            f"{num_episodes}; play more with `begin_episode()`. Episodes that began with "
            "`explore=False` are not learned from."
        )
    mean_return = float(np.mean([episode.undiscounted_return for episode in state.episodes]))
    if state.search is not None:
        searched = _searched(state, state.search, horizon)
        return searched, AdaptationInfo(mean_return, num_episodes, False, False)
    if state.undo is not None and safeguards.is_drop(mean_return, state.undo.mean_return):
        restored = ExplorerState(state.undo.latent, state.update + 1)
        return restored, AdaptationInfo(mean_return, num_episodes, True, False)
    moved = _moved(state, rule)
    bound = safeguards.max_latent_norm
    latent = moved if bound is None else moved.within(bound)
    undo = Undo(state.latent, mean_return)
    info = AdaptationInfo(mean_return, num_episodes, False, latent is not moved)
    return ExplorerState(latent, state.update + 1, undo=undo), info


def _searched(state: ExplorerState, search: LatentSearch, horizon: int) -> ExplorerState:
    """Return the state of a search after its episodes; its latent is what it would deploy."""
    readings = [
        Reading(
            search.index(episode.latent),
            episode.undiscounted_return,
            len(episode.rewards) / horizon,
        )
        for episode in state.episodes
    ]
    found = search.after(readings)
    latent = replace(state.latent, mean=found.latent(found.best))
    return ExplorerState(latent, state.update + 1, search=found)


def _moved(state: ExplorerState, rule: LearningRule) -> Latent:
    """Return the latent one policy-gradient step further."""
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
