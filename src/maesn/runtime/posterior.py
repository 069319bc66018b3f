"""The posterior over the returns of latents in a new task, under one model of them."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from maesn.runtime.arrays import FloatArray
from maesn.runtime.return_model import ReturnModel

# A return is an outlier if it is further from every task's prediction than this, in standard
# deviations. Its noise is then raised until it is exactly this far from the nearest prediction.
OUTLIER = 4.0
# Episodes have no noise if its variance is less than this share of that of returns.
KNOWN = 1e-9
# Standard deviation where nothing varies, as a share of the largest error: squares stay finite.
_LEAST_STD = 1e-150


@dataclass(frozen=True)
class Reading:
    """One observed return.

    Attributes:
        point: index of the latent that was played.
        episode_return: y, the return of the episode.
        length: l, steps of the episode as a share of the horizon.
    """

    point: int
    episode_return: float
    length: float = 1.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.episode_return) and math.isfinite(self.length)):
            raise ValueError(f"a return and its length must be finite, got {self}.")


class Prediction(NamedTuple):
    """What is predicted of the return of an episode."""

    mean: FloatArray
    """Mean in each component, `[task]`."""
    std: float
    """Standard deviation in each component, with the noise of the episode."""
    covariance: FloatArray
    """Covariance with f, `[point]`."""
    offset: float
    """Covariance with c."""


@dataclass(frozen=True)
class Posterior:
    """The posterior of f at some latents, given some readings.

    The components of the mixture, one per training task, share one covariance. Let L be the
    Cholesky factor of the covariance of the readings. The posterior keeps L^-1 cov(readings, f) and
    L^-1 cov(readings, c). A further reading adds one row to each and changes no other.

    Attributes:
        model: the model of the returns.
        points: the latents, `[point, z]`.
        task_mean: mean of f if the new task is like training task i, `[task, point]`.
        task_offset: mean of c if the new task is like training task i, `[task]`.
        variance: variance of f in each component, `[point]`.
        noise: variance of one episode's return, `[point]`.
        rows: L^-1 cov(readings, f), `[reading, point]`.
        offset_rows: L^-1 cov(readings, c), `[reading]`.
        readings: the readings so far.
        scales: diagonal of L, the predicted standard deviation of each reading given those before
            it, `[reading]`.
        innovations: each reading minus its prediction in each component, divided by its scale,
            `[reading, task]`.
    """

    model: ReturnModel
    points: FloatArray
    task_mean: FloatArray
    task_offset: FloatArray
    variance: FloatArray
    noise: FloatArray
    rows: FloatArray
    offset_rows: FloatArray
    readings: tuple[Reading, ...]
    scales: FloatArray
    innovations: FloatArray

    @staticmethod
    def of_prior(model: ReturnModel, points: FloatArray) -> "Posterior":
        """Return the distribution at some latents before any reading."""
        return Posterior(
            model,
            points,
            model.task_means(points),
            np.full(model.num_tasks, model.prior.offset_mean),
            np.full(len(points), model.variance),
            model.noise(points),
            rows=np.zeros((0, len(points))),
            offset_rows=np.zeros(0),
            readings=(),
            scales=np.zeros(0),
            innovations=np.zeros((0, model.num_tasks)),
        )

    @property
    def task_evidence(self) -> FloatArray:
        """Log probability density of the readings in each component, up to a constant, `[task]`."""
        scales = self.scales[np.isfinite(self.scales)]
        return np.asarray(-0.5 * (self.innovations**2).sum(axis=0) - np.log(scales).sum())

    @property
    def task_weights(self) -> FloatArray:
        """Posterior probability that the new task is like each training task, `[task]`."""
        return normalized(self.task_evidence)

    @property
    def mean(self) -> FloatArray:
        """Mean of f, `[point]`."""
        return np.asarray(self.task_weights @ self.task_mean)

    @property
    def std(self) -> FloatArray:
        """Standard deviation of f, `[point]`."""
        between = self.task_weights @ (self.task_mean - self.mean) ** 2
        return np.sqrt(between + np.maximum(self.variance, 0.0))

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether a latent would return what it did before: no noise, `[point]`."""
        known = np.zeros(len(self.points), bool)
        played = [one.point for one in self.readings]
        known[played] = self.noise[played] <= KNOWN * self.model.variance
        return known

    def predicted(self, point: int, length: float = 1.0) -> Prediction:
        """Return what is predicted of an episode's return, given the readings so far."""
        z = self.points[point : point + 1]
        reading_row = self.rows[:, point] + length * self.offset_rows
        covariance = self.model.covariance(z, self.points)[0] - reading_row @ self.rows
        offset = length * self.model.prior.offset_std**2 - float(reading_row @ self.offset_rows)
        variance = float(covariance[point]) + length * offset + float(self.noise[point])
        mean = self.task_mean[:, point] + length * self.task_offset
        return Prediction(mean, float(np.sqrt(max(variance, 0.0))), covariance, offset)

    def conditioned(self, reading: Reading) -> "Posterior":
        """Return the posterior with one more reading: one step of a Cholesky decomposition."""
        expected, std, covariance, offset = self.predicted(reading.point, reading.length)
        error = reading.episode_return - expected
        if self.known[reading.point] or self._is_twin(reading.point, std):
            scale = np.inf  # it teaches nothing, so its row is zero
        else:
            nearest, furthest = float(np.abs(error).min()), float(np.abs(error).max())
            scale = max(std, nearest / OUTLIER, _LEAST_STD * max(furthest, 1.0))
        innovation, row, offset_row = error / scale, covariance / scale, offset / scale
        return replace(
            self,
            task_mean=self.task_mean + np.outer(innovation, row),
            task_offset=self.task_offset + innovation * offset_row,
            variance=self.variance - row**2,
            rows=np.vstack([self.rows, row]),
            offset_rows=np.append(self.offset_rows, offset_row),
            readings=(*self.readings, reading),
            scales=np.append(self.scales, scale),
            innovations=np.vstack([self.innovations, innovation]),
        )

    def _is_twin(self, point: int, std: float) -> bool:
        """Whether a latent returns what an equal one did: nothing is left to know but rounding."""
        variance = self.model.variance
        rounding = KNOWN * variance
        return variance > 0.0 and bool(self.noise[point] <= rounding) and std**2 <= rounding

    def extended(self, more: FloatArray) -> "Posterior":
        """Return the posterior at its latents and at some more."""
        covariance = self.model.covariance(self.points[[one.point for one in self.readings]], more)
        rows = np.zeros((len(self.readings), len(more)))
        for index, reading in enumerate(self.readings):
            reading_row = (
                self.rows[:index, reading.point] + reading.length * self.offset_rows[:index]
            )
            rows[index] = (covariance[index] - reading_row @ rows[:index]) / self.scales[index]
        before = Posterior.of_prior(self.model, more)
        task_mean = before.task_mean + self.innovations.T @ rows
        variance = before.variance - (rows**2).sum(axis=0)
        return replace(
            self,
            points=np.concatenate([self.points, more]),
            task_mean=np.hstack([self.task_mean, task_mean]),
            variance=np.append(self.variance, variance),
            noise=np.append(self.noise, before.noise),
            rows=np.hstack([self.rows, rows]),
        )


def normalized(log_weights: FloatArray) -> FloatArray:
    """Return weights that add up to 1, given their logarithms up to a constant."""
    weights = np.exp(log_weights - log_weights.max())
    return np.asarray(weights / weights.sum())
