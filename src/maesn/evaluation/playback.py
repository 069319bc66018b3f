"""Record what a robot does in one new task while it adapts to it, state by state."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from maesn.axes import HostReadings, Readings
from maesn.evaluation.evaluate import adapt
from maesn.experience.episodes import Episodes
from maesn.learners import AbstractFastLearner
from maesn.worlds import AbstractWorld
from maesn.worlds.collector import Collector


class Playback(NamedTuple):
    """Some episodes of one task that were played after a number of updates."""

    update: int
    mean_return: float
    """Over all episodes that were played, not only those that are kept here."""
    success_rate: float
    """Share of all episodes that reach the goal region at some time."""
    readings: HostReadings
    """States of the episodes that are kept, `[time_plus_1, episode, ...]` each."""
    num_steps: Int[np.ndarray, " episode"]
    """Steps until an episode ended; the states behind are garbage."""
    returns: Float[np.ndarray, " episode"]
    solved: Bool[np.ndarray, " episode"]
    """Whether the episode reaches the goal region at some time."""


def record_adaptation(
    learner: AbstractFastLearner[Any],
    world: AbstractWorld,
    *,
    episodes_per_update: int,
    task: int,
    updates: Sequence[int],
    num_episodes: int,
    seed: int = 0,
) -> list[Playback]:
    """Adapt to one task and keep the states of some of the episodes.

    The episodes are those that `evaluate.adapt` plays in this task with the same seed.

    Args:
        learner: learns in the task.
        world: where the episodes are played.
        episodes_per_update: how many of them an update learns from.
        task: index of the task.
        updates: numbers of updates after which episodes are kept, ascending.
        num_episodes: how many are kept each time: the first ones that are played.
        seed: of the episodes.
    """
    kept: list[tuple[Any, ...]] = []

    def keep(episodes: Episodes, readings: Readings | HostReadings, stage: int) -> None:
        # With one task at a time, its episodes are the simulations.
        if stage in updates:
            shown = jax.tree.map(lambda x: np.asarray(x[:, :num_episodes]), readings)
            kept.append((shown, *_of_each(episodes, num_episodes)))

    curves = adapt(
        learner,
        Collector(world, episodes_per_update, keep),
        episodes=max(updates) * episodes_per_update,
        seed=seed,
        tasks=[task],
    ).explored
    returns, rates = curves.mean_return[0], curves.success_rate[0]
    return [
        Playback(update, float(returns[update]), float(rates[update]), *what)
        for update, what in zip(updates, kept, strict=True)
    ]


def _of_each(episodes: Episodes, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return number of steps, return and success of the first episodes of the only task."""
    valid, solved = np.asarray(episodes.valid[0]), np.asarray(episodes.solved[0])
    returns = np.asarray(episodes.undiscounted_return[0])
    return valid.sum(-1)[:count], returns[:count], (valid & solved).any(-1)[:count]
