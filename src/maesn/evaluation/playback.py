"""Record what a robot does in one new task while it adapts to it, state by state."""

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from maesn.axes import HostReadings, TaskKeys
from maesn.evaluation.evaluate import adapt
from maesn.experience.agent import Agents
from maesn.experience.episodes import Collect, Episodes
from maesn.learners import AbstractFastLearner
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


class _Recorder(Collect):
    """A collector that keeps the first episodes of some of its batches."""

    def __init__(self, collect: Collector, updates: Collection[int], num_episodes: int) -> None:
        self._collect = collect
        self._wanted = updates
        self._num_episodes = num_episodes
        self.kept: list[tuple[Episodes, HostReadings]] = []

    @property
    def num_tasks(self) -> int:
        """See `Collect`."""
        return self._collect.num_tasks

    @property
    def episodes_per_task(self) -> int:
        """See `Collect`."""
        return self._collect.episodes_per_task

    def __call__(
        self, keys: TaskKeys, agents: Agents, task_index: Int[Array, " task"], stage: int = 0
    ) -> Episodes:
        """See `Collect`; with one task at a time, its episodes are the simulations."""
        episodes, readings = self._collect.play(keys, agents, task_index)
        if stage in self._wanted:
            shown = jax.tree.map(lambda x: np.asarray(x[:, : self._num_episodes]), readings)
            self.kept.append((episodes, shown))
        return episodes


def record_adaptation(
    learner: AbstractFastLearner[Any],
    collect: Collector,
    *,
    task: int,
    updates: Sequence[int],
    num_episodes: int,
    seed: int = 0,
) -> list[Playback]:
    """Adapt to one task and keep the states of some of the episodes.

    The episodes are those that `evaluate.adapt` plays in this task with the same seed.

    Args:
        learner: learns in the task.
        collect: plays the episodes of each update.
        task: index of the task.
        updates: numbers of updates after which episodes are kept, ascending.
        num_episodes: how many are kept each time: the first ones that are played.
        seed: of the episodes.
    """
    recorder = _Recorder(collect, updates, num_episodes)
    outcome = adapt(
        learner,
        recorder,
        episodes=max(updates) * collect.episodes_per_task,
        seed=seed,
        tasks=[task],
    )
    curves = outcome.explored
    return [
        Playback(
            update,
            float(curves.mean_return[0, update]),
            float(curves.success_rate[0, update]),
            readings,
            *_of_each(episodes, num_episodes),
        )
        for update, (episodes, readings) in zip(updates, recorder.kept, strict=True)
    ]


def _of_each(episodes: Episodes, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    valid, solved = np.asarray(episodes.valid[0]), np.asarray(episodes.solved[0])
    returns = np.asarray(episodes.undiscounted_return[0])
    return valid.sum(-1)[:count], returns[:count], (valid & solved).any(-1)[:count]
