"""Search in the latent space: which latent to play next in a new task, and which to deploy."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, get_args

import numpy as np

from maesn.runtime.arrays import FloatArray
from maesn.runtime.return_model import Points, Posterior, Reading, ReturnModel, ReturnPrior

# Of the best point, before latents around it are drawn: by then the archive has shown its best.
PLAYS = 2

AcquisitionName: TypeAlias = Literal["ucb", "thompson"]


@dataclass(frozen=True)
class SearchSettings:
    """How a search chooses.

    Attributes:
        acquisition: `ucb`, the upper confidence bound: the largest mean + exploration * std. Or
            `thompson`: the largest value of a function that is drawn from the posterior.
        exploration: weight of the standard deviation in the upper confidence bound.
        draws: latents that are drawn around the best one in every round, once it has been played;
            0 stays with the archive.
        draw_std: their standard deviation around it, in units of z.
        residual: variance of what no training task shows, as a share of the mean variance over
            training tasks.
        length_scale: distance in z over which that varies.

    Raises:
        ValueError: a setting is out of its range.
    """

    acquisition: AcquisitionName = "ucb"
    exploration: float = 2.0
    draws: int = 8
    draw_std: float = 0.2
    residual: float = 0.03
    length_scale: float = 1.0

    def __post_init__(self) -> None:
        if self.acquisition not in get_args(AcquisitionName):
            names = ", ".join(get_args(AcquisitionName))
            raise ValueError(f"`acquisition` must be one of {names}, got {self.acquisition!r}.")
        for name in ("exploration", "draws", "residual"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"`{name}` must be at least 0, got {getattr(self, name)}.")
        for name in ("draw_std", "length_scale"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"`{name}` must be positive, got {getattr(self, name)}.")

    def model(self, prior: ReturnPrior) -> ReturnModel:
        """Return the model of returns that a prior makes."""
        return ReturnModel(prior, self.residual, self.length_scale)


@dataclass(frozen=True)
class LatentSearch:
    """A search in one task.

    Attributes:
        model: of the returns; shared by all tasks.
        settings: how it chooses.
        points: the archive, and the latents that were drawn around the best ones and played.
        posterior: of the returns at these points.
    """

    model: ReturnModel
    settings: SearchSettings
    points: Points
    posterior: Posterior

    @staticmethod
    def start(model: ReturnModel, settings: SearchSettings) -> "LatentSearch":
        """Return a search that has not played yet."""
        points = model.archive
        return LatentSearch(model, settings, points, Posterior.of_prior(model, points))

    @property
    def best(self) -> int:
        """Index of the point to deploy: that of the highest posterior mean."""
        return int(np.argmax(self.posterior.mean))

    def latent(self, point: int) -> FloatArray:
        """Return z of a point, `[z]`."""
        return self.points.latents[point]

    def proposed(self, generator: np.random.Generator) -> "tuple[LatentSearch, int]":
        """Choose the point to play next.

        Args:
            generator: of the draws around the best point, and of Thompson sampling.

        Returns:
            The search, which may have one more point, and the index of the chosen point.
        """
        chosen = int(np.argmax(self.scores(generator)))
        if self.settings.draws == 0 or chosen != self.best or self._plays(chosen) < PLAYS:
            return self, chosen
        wider = self._with_draws(generator)
        refined = int(np.argmax(wider.scores(generator)))
        if refined < len(self.points):
            return self, chosen
        return self.with_latent(wider.latent(refined)), len(self.points)

    def with_latent(self, z: FloatArray) -> "LatentSearch":
        """Return the search with one more point."""
        return self._with_points(self.model.points(z[None]))

    def after(self, readings: Iterable[Reading]) -> "LatentSearch":
        """Return the search after some episodes."""
        posterior = self.posterior
        for reading in readings:
            posterior = posterior.conditioned(self.model, self.points, reading)
        return replace(self, posterior=posterior)

    def scores(self, generator: np.random.Generator) -> FloatArray:
        """Return what the acquisition rule gives each point, `[point]`."""
        if self.settings.acquisition == "thompson":
            return self._sample(generator)
        return self.posterior.mean + self.settings.exploration * self.posterior.std

    def _sample(self, generator: np.random.Generator) -> FloatArray:
        """Draw f from the posterior: a draw from the prior, conditioned on the readings.

        Matheron's rule: what the readings change about a function is linear in what they differ
        from it, so a draw from the prior that is corrected by the readings, less noise, is a draw
        from the posterior.
        """
        model, posterior = self.model, self.posterior
        covariance = model.covariance(self.points, self.points)
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        sample = model.mean(self.points) + root @ generator.standard_normal(len(values))
        prior = model.prior
        offset = prior.offset_mean + prior.offset_std * generator.standard_normal()
        noise = np.sqrt(model.noise(self.points))
        for index, reading in enumerate(posterior.readings):
            expected = sample[reading.point] + reading.length * offset
            drawn = expected + noise[reading.point] * generator.standard_normal()
            correction = (reading.episode_return - drawn) / posterior.scales[index]
            sample = sample + posterior.rows[index] * correction
            offset += posterior.offset_rows[index] * correction
        return sample

    def _with_draws(self, generator: np.random.Generator) -> "LatentSearch":
        shape = (self.settings.draws, self.points.latents.shape[1])
        around = self.settings.draw_std * generator.standard_normal(shape)
        return self._with_points(self.model.points(self.latent(self.best) + around))

    def _plays(self, point: int) -> int:
        return sum(reading.point == point for reading in self.posterior.readings)

    def _with_points(self, more: Points) -> "LatentSearch":
        return replace(
            self,
            points=self.points.joined(more),
            posterior=self.posterior.extended(self.model, self.points, more),
        )
