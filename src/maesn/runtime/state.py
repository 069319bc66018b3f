"""All that changes on a robot while it explores and learns, apart from its random numbers."""

from dataclasses import dataclass, replace

import numpy as np

from maesn.runtime.arrays import FloatArray, check_shapes
from maesn.runtime.episode import Episode, RunningEpisode, refuse_large
from maesn.runtime.exported import ExportedPolicy
from maesn.runtime.latent import Latent
from maesn.runtime.posterior import Reading
from maesn.runtime.search import LatentSearch


@dataclass(frozen=True)
class ExplorerState:
    """State of an explorer.

    Attributes:
        latent: the latent that the next z is drawn from.
        update: number of updates so far, which decides the size of the next step.
        episodes: episodes to learn from, finished since the last update.
        running: the episode that is being played, if any.
        search: state of the search; None where the latent follows its gradient.
        proposed: points of the search that several robots play, in the order of proposal.
        results: what other robots returned since the last update.
    """

    latent: Latent
    update: int = 0
    episodes: tuple[Episode, ...] = ()
    running: RunningEpisode | None = None
    search: LatentSearch | None = None
    proposed: tuple[int, ...] = ()
    results: tuple[Reading, ...] = ()

    def __post_init__(self) -> None:
        if self.search is not None:
            points = range(len(self.search.points))
            named = (*self.proposed, *(one.point for one in self.results))
            if not all(point in points for point in named):
                raise ValueError("`proposed` or `results` name points that are not there.")

    @staticmethod
    def new_task(exported: ExportedPolicy) -> "ExplorerState":
        """Return the state at the start of a new task."""
        search = None
        if exported.search is not None:
            search = LatentSearch.start(exported.search.model, exported.search.settings)
        return ExplorerState(exported.start, exported.start_update, search=search)

    def begun(
        self, explore: bool, z: FloatArray | None, generator: np.random.Generator
    ) -> "ExplorerState":
        """Return the state with a new episode running.

        `explore=False` holds z at the latent's mean, or at the best point of a search. A z of None,
        `[latent]`, is drawn with the generator, or chosen by the search.
        """
        search = self.search
        if not explore:
            z = self.latent.mean if search is None else search.points[search.best]
        elif z is None and search is not None:
            search, point = search.proposed(generator)
            z = search.points[point]
        elif z is None:
            z = self.latent.draw(generator.standard_normal(self.latent.mean.size))
        elif search is not None and not (search.points == z).all(axis=1).any():
            search = search.with_points(z[None])
        running = RunningEpisode(z.copy(), "explore" if explore else "deploy")
        return replace(self, running=running, search=search)

    def running_for(self, call: str) -> RunningEpisode:
        """Return the running episode; raises RuntimeError if there is none."""
        if self.running is None:
            raise RuntimeError(f"`{call}` needs a running episode; call `begin_episode()` first.")
        return self.running

    def refuse_running(self, call: str) -> None:
        """Raise RuntimeError if an episode is running."""
        if self.running is not None:
            raise RuntimeError(
                f"`{call}` was called while an episode of {self.running.num_steps} steps is "
                "running; finish it with `end_episode(rewards)` or call `discard()` first."
            )

    def search_for(self, call: str) -> LatentSearch:
        """Return the search; raises RuntimeError if there is none."""
        if self.search is None:
            raise RuntimeError(f"`{call}` needs a search: export with the rule `search`.")
        return self.search

    def told(self, point: int, rewards: FloatArray, horizon: int) -> "ExplorerState":
        """Return the state with what another robot got for a point."""
        refuse_large(rewards)
        result = Reading(point, float(rewards.sum()), len(rewards) / horizon)
        return replace(self, results=(*self.results, result))

    def readings(self, horizon: int) -> list[Reading]:
        """Return what a search learns next, in the order of proposal; the unproposed is last."""
        search = self.search_for("adapt")
        own = [
            Reading(
                search.index(episode.latent),
                episode.undiscounted_return,
                len(episode.rewards) / horizon,
            )
            for episode in self.episodes
        ]
        place = {point: number for number, point in enumerate(self.proposed)}
        return sorted([*own, *self.results], key=lambda one: place.get(one.point, len(place)))

    def check_sizes(self, exported: ExportedPolicy) -> None:
        """Raise ValueError if the latents and episodes are those of another policy."""
        latent, sizes = exported.latent_size, (exported.observation_size, exported.action_size)
        check_shapes(self.latent, (latent,), "mean", "log_std")
        episodes, running = list(self.episodes), self.running
        if running is not None:
            check_shapes(running, (latent,), "latent")
            if steps := max(map(len, (running.observations, running.actions, running.controls))):
                episodes.append(running.finished(np.zeros(steps)))
        for episode in episodes:
            steps = max(episode.rewards.size, 1)
            check_shapes(episode, (latent,), "latent")
            check_shapes(episode, (steps,), "rewards")
            check_shapes(episode, (steps, sizes[0]), "observations")
            check_shapes(episode, (steps, sizes[1]), "actions", "controls")
