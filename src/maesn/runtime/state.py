"""All that changes on a robot while it explores and learns, apart from its random numbers."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from maesn.runtime.archive import entry
from maesn.runtime.arrays import Arrays, FloatArray, named, take, taken
from maesn.runtime.episode import (
    PURPOSES,
    Episode,
    Purpose,
    RunningEpisode,
    episodes_from_arrays,
    episodes_to_arrays,
    refuse_large,
)
from maesn.runtime.exported import ExportedPolicy
from maesn.runtime.latent import LATENT, Latent
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

    @staticmethod
    def new_task(exported: ExportedPolicy) -> "ExplorerState":
        """Return the state at the start of a new task."""
        search = None
        if exported.search is not None:
            search = LatentSearch.start(exported.search.model, exported.search.settings)
        return ExplorerState(exported.start, exported.start_update, search=search)

    def within(self, max_norm: float | None) -> "ExplorerState":
        """Return the state whose search chooses no z of a larger Euclidean norm; None: of any."""
        if self.search is None:
            return self
        bound = np.inf if max_norm is None else max_norm
        return replace(self, search=replace(self.search, max_norm=bound))

    def begun(
        self, explore: bool, z: FloatArray | None, generator: np.random.Generator
    ) -> "ExplorerState":
        """Return the state with a new episode running.

        `explore=False` holds z at the latent's mean, or at the best point of a search. A z of None,
        `[latent]`, is drawn with the generator, or chosen by the search.
        """
        if self.search is not None:
            search = self.search
            if not explore:
                best = search.latent(search.best).copy()
                return replace(self, running=RunningEpisode(best, "deploy"))
            if z is None:
                search, point = search.proposed(generator)
                z = search.latent(point).copy()
            elif not search.has(z):
                search = search.with_latent(z)
            return replace(self, running=RunningEpisode(z), search=search)
        if not explore:
            return replace(self, running=RunningEpisode(self.latent.mean.copy(), "deploy"))
        if z is None:
            z = self.latent.draw(generator.standard_normal(self.latent.mean.size))
        return replace(self, running=RunningEpisode(z))

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

    def proposing(
        self, count: int, generator: np.random.Generator
    ) -> "tuple[ExplorerState, FloatArray]":
        """Return the state after a proposal of several z, and these, `[robot, latent]`."""
        search, proposed = self.search_for("propose").proposed_together(generator, count)
        return replace(self, search=search, proposed=proposed), search.points[list(proposed)]

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

    def arrays(self, exported: ExportedPolicy) -> Arrays:
        """Return the arrays to save in a file."""
        kept = named("latent", self.latent, *LATENT) | episodes_to_arrays(self.episodes)
        if self.running is not None:
            kept |= self.running.arrays(exported.observation_size, exported.action_size)
        if self.search is None:
            return kept
        return kept | self.search.arrays() | _results_to_arrays(self.proposed, self.results)

    def metadata(self) -> dict[str, Any]:
        """Return the other values to save in a file."""
        purpose = "explore" if self.running is None else self.running.purpose
        return {"update": self.update, "purpose": purpose}

    @staticmethod
    def from_archive(
        arrays: Arrays, metadata: Mapping[str, Any], exported: ExportedPolicy
    ) -> "ExplorerState":
        """Rebuild a saved state; raises ValueError if a part is missing or does not fit."""
        size = exported.latent_size
        sizes = (exported.observation_size, exported.action_size, size)
        running = None
        if "running.latent" in arrays:
            running = RunningEpisode.from_arrays(arrays, *sizes, purpose=_purpose(metadata))
        state = ExplorerState.new_task(exported)
        if state.search is not None:
            search = state.search.repeated(arrays)
            proposed, results = _results_from_arrays(arrays, len(search.points))
            state = replace(state, search=search, proposed=proposed, results=results)
        return replace(
            state,
            latent=Latent(**taken(arrays, "latent", size, *LATENT)),
            update=entry(metadata, "update", int),
            episodes=episodes_from_arrays(arrays, *sizes),
            running=running,
        )


def _purpose(metadata: Mapping[str, Any]) -> Purpose:
    found: Any = metadata.get("purpose")
    if found not in PURPOSES:
        raise ValueError(f"entry `purpose` must be 'explore' or 'deploy', got {found!r}.")
    purpose: Purpose = found
    return purpose


_RESULTS = ("point", "episode_return", "length")


def _results_to_arrays(proposed: tuple[int, ...], results: tuple[Reading, ...]) -> Arrays:
    fields = {name: [getattr(one, name) for one in results] for name in _RESULTS}
    return {
        "proposed": np.asarray(proposed, np.float64),
        **{f"results.{name}": np.asarray(values, np.float64) for name, values in fields.items()},
    }


def _results_from_arrays(
    arrays: Arrays, num_points: int
) -> tuple[tuple[int, ...], tuple[Reading, ...]]:
    if "proposed" not in arrays:  # written before searches proposed several z
        return (), ()
    proposed = _points(take(arrays, "proposed", -1), num_points)
    points = _points(take(arrays, "results.point", -1), num_points)
    rest = [take(arrays, f"results.{name}", len(points)).tolist() for name in _RESULTS[1:]]
    return proposed, tuple(map(Reading, points, *rest))


def _points(stated: FloatArray, num_points: int) -> tuple[int, ...]:
    points = tuple(int(point) for point in stated)
    if not all(0 <= point < num_points for point in points):
        raise ValueError("array `proposed` or `results.point` names points that are not there.")
    return points
