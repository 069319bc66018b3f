"""One update of the latent from a batch of episodes, with its safeguards."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from maesn.runtime.baseline import episode_advantages
from maesn.runtime.latent import Latent, LearningRule
from maesn.runtime.posterior import Reading
from maesn.runtime.safeguards import Safeguards
from maesn.runtime.search import LatentSearch
from maesn.runtime.state import ExplorerState, Undo

# One episode has no other to be better or worse than: its standardised advantage is 0.
MINIMUM_EPISODES = 2


class AdaptationInfo(NamedTuple):
    """The outcome of a call of `Explorer.adapt`."""

    mean_return: float
    """Mean undiscounted return of the batch."""
    num_episodes: int
    """Number of episodes in the batch, without those played with `explore=False`."""
    rolled_back: bool
    """Whether the last update was taken back instead of making a new one."""
    shortened: bool
    """Whether `max_latent_norm` shortened the update."""


def learned(
    state: ExplorerState, rule: LearningRule, safeguards: Safeguards, horizon: int = 1
) -> tuple[ExplorerState, AdaptationInfo]:
    """Return the state after an update from its episodes, which it no longer holds.

    Args:
        state: the state, with the episodes to learn from, and none running.
        rule: the policy-gradient update of the latent.
        safeguards: limits of the latent's norm and of the drop in return.
        horizon: steps of a full episode, for a search.

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
        info = AdaptationInfo(mean_return, num_episodes, rolled_back=False, shortened=False)
        return _after_search(state, state.search, horizon), info
    if state.undo is not None and safeguards.is_drop(mean_return, state.undo.mean_return):
        info = AdaptationInfo(mean_return, num_episodes, rolled_back=True, shortened=False)
        return ExplorerState(state.undo.latent, state.update + 1), info
    stepped = _policy_gradient_step(state, rule)
    bound = safeguards.max_latent_norm
    latent = stepped if bound is None else stepped.within(bound)
    shortened = latent is not stepped
    info = AdaptationInfo(mean_return, num_episodes, rolled_back=False, shortened=shortened)
    undo = Undo(state.latent, mean_return)
    return ExplorerState(latent, state.update + 1, undo=undo), info


def surprise(state: ExplorerState, horizon: int) -> str:
    """Return a sentence if the next update is the first with returns that no prior explains."""
    if state.search is None or state.search.is_surprised:
        return ""
    return state.search.complaint(_readings(state, state.search, horizon))


def _readings(state: ExplorerState, search: LatentSearch, horizon: int) -> list[Reading]:
    return [
        Reading(
            search.index(episode.latent),
            episode.undiscounted_return,
            len(episode.rewards) / horizon,
        )
        for episode in state.episodes
    ]


def _after_search(state: ExplorerState, search: LatentSearch, horizon: int) -> ExplorerState:
    """Return the state after an update of the search; its latent is the one to deploy."""
    search = search.after(_readings(state, search, horizon))
    latent = replace(state.latent, mean=search.latent(search.best))
    return ExplorerState(latent, state.update + 1, search=search)


def _policy_gradient_step(state: ExplorerState, rule: LearningRule) -> Latent:
    """Return the latent after one policy-gradient step."""
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
