"""Searches that are played from recorded episodes: the archive of a run in all tasks of a set.

A search plays one latent of the archive at a time. Its episode is the next recorded one of that
latent in that task, so all searches see the same returns. The latent that it deploys is judged by
the mean of recorded episodes that no search has seen. This is exact for whoever chooses from the
archive alone. It leaves out latents between those of the archive.
"""

import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeAlias

import jax
import numpy as np
from numpy.typing import NDArray
from search_rows import private_copy

from maesn.runs.run import Run
from maesn.runtime.arrays import FloatArray
from maesn.runtime.return_model import ReturnPrior
from maesn.search import PriorSettings, latent_of, play_archive
from maesn.search.stored import prior_file, read_prior

JUDGED_AFTER = (1, 2, 3, 5, 10, 20)
EPISODES = {"blockpush": 2}  # of each latent; start and physics are exact, so both are the same
USUAL_EPISODES = 16

Points: TypeAlias = NDArray[np.intp]


@dataclass(frozen=True)
class Recorded:
    """Episodes of an archive in the tasks of a set, `[task, latent, episode]` each."""

    returns: FloatArray
    length: FloatArray
    """As a share of the horizon."""
    far: FloatArray
    """What each task returns to who never finds the goal, `[task]`."""

    def __getitem__(self, tasks: slice) -> "Recorded":
        return Recorded(self.returns[tasks], self.length[tasks], self.far[tasks])

    @property
    def half(self) -> int:
        """Episodes that searches see; the others judge."""
        return self.returns.shape[2] // 2

    @property
    def truth(self) -> FloatArray:
        """What the latents return in the episodes that judge, `[task, latent]`."""
        return np.asarray(self.returns[:, :, self.half :].mean(axis=2))


class Search(Protocol):
    """A search in some tasks at once, over the points of an archive; `[task]` everywhere."""

    def propose(self) -> Points:
        """Return the points to play next."""

    def told(self, points: Points, returns: FloatArray, lengths: FloatArray) -> None:
        """Learn from an episode in each task."""

    def best(self) -> Points:
        """Return the points to deploy."""


def prior_of(run: Run) -> ReturnPrior:
    """Return the prior of a run for its sparse reward."""
    with closing(run.world(reward_kind="sparse")) as world:
        return read_prior(prior_file(run, world.env))[0]


def recorded(name: str, tasks: str, out: Path) -> Recorded:
    """Play the archive of a run in the tasks of a set; kept in a file.

    Args:
        name: the run, or a policy that comes with the library.
        tasks: name or file of the task set.
        out: where files are.
    """
    path = out / f"{name}-{Path(tasks).stem}.npz"
    if not path.exists():
        run = private_copy(name, name, out)
        latent = latent_of(run.learner.fast_learner(run.latest_state()))
        settings = PriorSettings(episodes=EPISODES.get(name, USUAL_EPISODES), seed=1)
        with closing(run.world(run.task_set(tasks), "sparse")) as world:
            returns, length = play_archive(latent, world, prior_of(run).latents, settings)
            far = world.env.horizon * np.asarray(jax.vmap(world.env.far_reward)(world.tasks.tasks))
        np.savez(path, returns=np.float32(returns), length=np.float32(length), far=far)
    with np.load(path) as kept:
        return Recorded(**{name: np.float64(kept[name]) for name in ("returns", "length", "far")})


def searched(search: Search, episodes: Recorded) -> tuple[FloatArray, float]:
    """Search in all tasks.

    Args:
        search: one that has not played yet.
        episodes: what latents return in the tasks.

    Returns:
        Mean return of the deployed latents, `[task, count]`; and seconds of the processor for a
        proposal in all tasks, with what is learned before it.
    """
    truth, spent, found = episodes.truth, 0.0, []
    tasks = np.arange(len(truth))
    played = np.zeros(truth.shape, int)
    for count in range(1, max(JUDGED_AFTER) + 1):
        begin = time.thread_time()
        points = search.propose()
        spent += time.thread_time() - begin
        episode = (tasks, points, played[tasks, points] % episodes.half)
        played[tasks, points] += 1
        begin = time.thread_time()
        search.told(points, episodes.returns[episode], episodes.length[episode])
        spent += time.thread_time() - begin
        if count in JUDGED_AFTER:
            found.append(truth[tasks, search.best()])
    return np.stack(found, axis=1), spent / count
