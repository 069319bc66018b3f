"""Search in the latent space: which latent to play next in a new task, and which to deploy."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from maesn.runtime.arrays import FloatArray, check_shapes
from maesn.runtime.hypotheses import MixedPosterior
from maesn.runtime.posterior import Reading
from maesn.runtime.return_model import ReturnModel, ReturnPrior

# Plays of the best point before latents are drawn around it. By then the archive is explored.
PLAYS = 2

AcquisitionName: TypeAlias = Literal["ucb", "thompson"]


@dataclass(frozen=True)
class SearchSettings:
    """Settings of a search.

    Attributes:
        acquisition: both draw a hypothesis about the task by its posterior probability. Under it,
            `ucb` maximises the upper confidence bound, mean + exploration * std; `thompson` draws a
            training task by its posterior probability and takes that task's best latent.
        exploration: weight of the standard deviation in the upper confidence bound.
        draws: latents that are drawn around the best one in every round, once it has been played
            twice or its return is known exactly; 0 stays with the archive.
        draw_std: standard deviation of these draws, in units of z.
        residual: variance of a new task's returns that no training task explains, as a share of
            the mean variance over training tasks.
        length_scale: distance in z over which returns vary.
        jumps: whether the model allows for jumps of the return between near latents.
        familiar: probability, before the first episode, that a new task is like a training task. 1
            leaves out the other hypotheses.

    Raises:
        ValueError: a setting is out of its range.
    """

    acquisition: AcquisitionName = "ucb"
    exploration: float = 2.0
    draws: int = 8
    draw_std: float = 0.2
    residual: float = 0.1
    length_scale: float = 1.0
    jumps: bool = True
    familiar: float = 0.7

    def __post_init__(self) -> None:
        if self.acquisition not in get_args(AcquisitionName):
            names = ", ".join(get_args(AcquisitionName))
            raise ValueError(f"`acquisition` must be one of {names}, got {self.acquisition!r}.")
        for name in ("exploration", "draws", "residual"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"`{name}` must be at least 0, got {getattr(self, name)}.")
        if not 0 < self.familiar <= 1:
            raise ValueError(f"`familiar` must be above 0 and at most 1, got {self.familiar}.")
        for name in ("draw_std", "length_scale"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"`{name}` must be positive, got {getattr(self, name)}.")

    def model(self, prior: ReturnPrior) -> ReturnModel:
        """Return the model of returns with a prior."""
        return ReturnModel(prior, self.residual, self.length_scale, self.jumps)


class Beliefs(NamedTuple):
    """Posterior of the part of the return that depends on the latent."""

    latents: FloatArray
    """`[point, latent]`."""
    mean: FloatArray
    """Posterior mean, `[point]`."""
    std: FloatArray
    """Posterior standard deviation, `[point]`."""
    interval: tuple[float, float]
    """90 % interval of the return of an episode with the latent to deploy."""
    familiar: float
    """Posterior probability that the task is like a training task: low where the search is lost."""


@dataclass(frozen=True)
class SearchHistory:
    """What a search has done, of which a file makes it again.

    Attributes:
        added: points that the archive does not have, `[point, z]`.
        added_after: number of readings before each of them.
        readings: what the search has learned from.
    """

    added: FloatArray
    added_after: tuple[int, ...]
    readings: tuple[Reading, ...]


@dataclass(frozen=True)
class LatentSearch:
    """A search in one task.

    Attributes:
        model: the model of the returns; shared by all tasks.
        settings: settings of the search.
        posterior: posterior of the returns at the archive's latents and the added ones.
        added_after: number of readings before each point that the archive does not have.
        max_norm: Euclidean norm of z beyond which no point is chosen.
    """

    model: ReturnModel
    settings: SearchSettings
    posterior: MixedPosterior
    added_after: tuple[int, ...] = ()
    max_norm: float = np.inf

    @staticmethod
    def start(model: ReturnModel, settings: SearchSettings) -> "LatentSearch":
        """Return a search that has not played yet."""
        return LatentSearch(model, settings, MixedPosterior.of_prior(model, settings.familiar))

    @property
    def points(self) -> FloatArray:
        """The latents that can be chosen, `[point, z]`."""
        return self.posterior.points

    @property
    def beliefs(self) -> Beliefs:
        """Beliefs about all points."""
        posterior = self.posterior
        interval = self.interval(self.best)
        points = self.points.copy()
        return Beliefs(points, posterior.mean, posterior.std, interval, posterior.familiar)

    @property
    def best(self) -> int:
        """Index of the point to deploy: that of the highest posterior mean."""
        return self.highest(self.posterior.mean)

    def interval(self, point: int) -> tuple[float, float]:
        """Return the 90 % interval of the return of an episode with a point."""
        posterior, prior = self.posterior, self.model.prior
        if posterior.known[point]:
            returns = {one.point: one.episode_return for one in posterior.readings}
            return returns[point], returns[point]
        is_deployed = point == self.best
        levels = prior.deployed_levels if is_deployed else prior.proposed_levels
        low, high = posterior.quantiles(point, levels)
        return low, high

    def proposed(
        self, generator: np.random.Generator, taken: Collection[int] = ()
    ) -> "tuple[LatentSearch, int]":
        """Choose the point to play next.

        The generator draws what the task may be, by its posterior probability: a hypothesis, and
        the training task of Thompson sampling; and the points around the best one. Others play the
        points `taken` already.

        Returns:
            The search, which may have one more point, and the index of the chosen point.
        """
        weights = self.posterior.weights
        component = int(generator.choice(len(weights), p=weights))
        chosen, best = self.highest(self.open_scores(component, taken)), self.best
        plays = sum(reading.point == best for reading in self.posterior.readings)
        is_explored = self.posterior.known[best] or (chosen == best and plays >= PLAYS)
        if self.settings.draws == 0 or not is_explored:
            return self, chosen
        shape = (self.settings.draws, self.points.shape[1])
        around = self.settings.draw_std * generator.standard_normal(shape)
        wider = self.with_points(self.points[best] + around)
        refined = wider.highest(wider.open_scores(component, taken))
        if refined < len(self.points):
            return self, chosen
        return self.with_points(wider.points[refined, None]), len(self.points)

    def proposed_together(
        self, generator: np.random.Generator, count: int
    ) -> "tuple[LatentSearch, tuple[int, ...]]":
        """Choose several points to play at the same time, by `count` robots.

        Each is chosen as if those before it had returned what the model expects of them.

        Returns:
            The search, which may have more points, and the indices of the chosen points.
        """
        search, believed = self, self
        chosen: list[int] = []
        for _ in range(count):
            believed, point = believed.proposed(generator, taken=chosen)
            if point == len(search.points):
                search = search.with_points(believed.points[point, None])
            chosen.append(point)
            believed = believed.after([believed.posterior.expected(point)])
        return search, tuple(chosen)

    def with_points(self, more: FloatArray) -> "LatentSearch":
        """Return the search with more points, `[point, z]`."""
        added_after = [len(self.posterior.readings)] * len(more)
        return replace(
            self,
            posterior=self.posterior.extended(more),
            added_after=(*self.added_after, *added_after),
        )

    def index(self, z: FloatArray) -> int:
        """Return the index of a point; raises `ValueError` if z is no point of this search."""
        found = np.flatnonzero((self.points == z).all(axis=1))
        if not len(found):
            raise ValueError(f"`z` {z} is no point of this search: give one that it proposed.")
        return int(found[0])

    @property
    def is_surprised(self) -> bool:
        """Whether some reading so far is beyond what the prior explains."""
        return any(map(self._is_beyond, self.posterior.readings))

    def complaint(self, readings: Iterable[Reading]) -> str:
        """Return a sentence about readings that the prior cannot explain; "" if there are none."""
        beyond = list(filter(self._is_beyond, readings))
        if not beyond:
            return ""
        returns = [reading.episode_return for reading in beyond]
        low, high = self.model.explained(beyond[0].length)
        return (
            f"episodes returned {min(returns):.6g} to {max(returns):.6g}, but the prior of the "
            f"search explains {low:.6g} to {high:.6g}: a search needs the reward that its prior "
            "was played with, every term of it and in the same unit."
        )

    def after(self, readings: Iterable[Reading]) -> "LatentSearch":
        """Return the search after some episodes."""
        posterior = self.posterior
        for reading in readings:
            posterior = posterior.conditioned(reading)
        return replace(self, posterior=posterior)

    def highest(self, scores: FloatArray) -> int:
        """Return the index of the highest score within `max_norm`, or of the nearest point."""
        norms = np.linalg.norm(self.points, axis=1)
        inside = np.flatnonzero(norms <= self.max_norm)
        if not len(inside):
            return int(np.argmin(norms))
        return int(inside[np.argmax(scores[inside])])  # one inside even if all scores are -inf

    def scores(self, component: int) -> FloatArray:
        """Return the acquisition function at each point, under one component, `[point]`."""
        part, task = self.posterior.part(component)
        if self.settings.acquisition == "thompson":
            return part.task_mean[task]
        return part.mean + self.settings.exploration * part.std

    def open_scores(self, component: int, taken: Collection[int]) -> FloatArray:
        """Return the scores of the points that are worth an episode, -inf for the others."""
        closed = self.posterior.known
        closed[list(taken)] = True
        return np.where(closed, -np.inf, self.scores(component))

    @property
    def history(self) -> SearchHistory:
        """All that this search has done."""
        added = self.points[len(self.model.archive) :]
        return SearchHistory(added, self.added_after, self.posterior.readings)

    def repeated(self, history: SearchHistory) -> "LatentSearch":
        """Return the search after the same points and readings, in the same order.

        Raises:
            ValueError: they are those of another search.
        """
        check_shapes(history, (len(history.added_after), self.points.shape[1]), "added")
        search, number = self, len(history.readings)
        for count in range(number + 1):
            for z in history.added[np.equal(history.added_after, count)]:
                search = search.with_points(z[None])
            readings = history.readings[count : count + 1]
            if not all(0 <= one.point < len(search.points) for one in readings):
                raise ValueError(f"`readings` name points that are not there: {readings}.")
            search = search.after(readings)
        if search.added_after != history.added_after:
            raise ValueError(f"`added_after` must count up to {number} readings, in order.")
        return search

    def _is_beyond(self, reading: Reading) -> bool:
        low, high = self.model.explained(reading.length)
        return not low <= reading.episode_return <= high
