"""A model of the return of each latent in a new task, learned from the training tasks.

A new task is like one of the T training tasks, up to a residual. The return of an episode with
latent z is

    y = f(z) + l c + noise,     f ~ (1/T) sum_i GP(x_i, R),     c ~ N(offset_mean, offset_std^2).

f is a uniform mixture of Gaussian processes, one per training task: x_i is the excess return in
training task i, and R the covariance of the residual. c is the return of a full-length episode that
never comes near the goal, and l the length of the episode as a share of the horizon.
`docs/explanation/methods/latent_search.md` has the equations.
"""

from dataclasses import dataclass, replace

import numpy as np

from maesn.runtime.arrays import FloatArray
from maesn.runtime.kernel import matern, roughness

# A return is an outlier if it is further from every task's prediction than this, in standard
# deviations. Its noise is then raised until it is exactly this far from the nearest prediction.
OUTLIER = 4.0
# A return is beyond the prior if it is further from every return of the archive than this, in
# standard deviations. In 300 new tasks of the policies that come with the library, 15 episodes
# each, the furthest was at 1.3 (tests/long/test_surprise.py holds them below 2); rewards times 0.1
# are at 2.8 or more, except on `blockpush`, where they look like those of a solved task.
BEYOND = 2.0
# Lower bound on the noise of the archive's returns, as a share of their variance: two equal latents
# must not make the kernel matrix singular.
_LEAST_NOISE = 1e-6
# Episodes have no noise if its variance is less than this share of that of returns.
KNOWN = 1e-9


@dataclass(frozen=True)
class ReturnPrior:
    """Returns of an archive of latents in the training tasks.

    Attributes:
        latents: the archive z_1 ... z_N, `[latent, z]`.
        excess: X_ij, the mean return of latent j in training task i minus l c, the return of
            episodes of the same length that never come near the goal, `[task, latent]`.
        noise: variance of the return of one episode, `[latent]`.
        episodes: number of episodes that each X_ij is the mean of.
        offset_mean: mean of c over the training tasks.
        offset_std: standard deviation of c over the training tasks.

    Raises:
        ValueError: a field has another shape, is not finite, or is out of its range.
    """

    latents: FloatArray
    excess: FloatArray
    noise: FloatArray
    episodes: int
    offset_mean: float
    offset_std: float

    def __post_init__(self) -> None:
        count = len(self.latents)
        shapes = (self.latents.ndim, self.excess.ndim, self.excess.shape[-1:], self.noise.shape)
        if shapes != (2, 2, (count,), (count,)) or count == 0:
            raise ValueError(
                "`latents`, `excess` and `noise` must have the shapes (latent, z), (task, latent) "
                f"and (latent,), got {self.latents.shape}, {self.excess.shape} and "
                f"{self.noise.shape}."
            )
        if len(self.excess) < 2:
            raise ValueError(f"`excess` must be of at least 2 tasks, got {len(self.excess)}.")
        numbers = (self.latents, self.excess, self.noise, self.offset_mean)
        if not all(np.isfinite(value).all() for value in numbers):
            raise ValueError("`latents`, `excess`, `noise` and `offset_mean` must be finite.")
        if self.noise.min() < 0 or self.episodes < 1:
            raise ValueError("`noise` must be at least 0 and `episodes` at least 1.")
        if not 0 <= self.offset_std < np.inf:
            raise ValueError(f"`offset_std` must be at least 0, got {self.offset_std}.")


class ReturnModel:
    """The mixture of Gaussian processes of a prior, at any latents.

    The excess return in a training task is a smooth function x_i(z), and the archive holds noisy
    values X_i of it. Gaussian process regression with kernel k, mean x, variance s^2 and noise
    variance d_j gives

        x_i(z) = x + s^2 k(z, Z) [s^2 k(Z, Z) + diag(d)]^-1 (X_i - x).

    Args:
        prior: the returns of the archive.
        residual: variance of R, as a share of the variance of x_i(z) over the training tasks,
            averaged over the archive.
        length_scale: length scale of k and of R, a distance in z.
        jumps: whether returns may jump from a latent to the next, where one comes near the goal and
            the other does not. Their variance, as found in the archive (`roughness`), is then added
            to k and to R for each latent by itself.
    """

    def __init__(
        self, prior: ReturnPrior, residual: float, length_scale: float, jumps: bool = True
    ) -> None:
        self.prior = prior
        self.archive = prior.latents
        self._length_scale = length_scale
        self._average = float(prior.excess.mean())
        centred = prior.excess - self._average
        spread = float((centred**2).mean())
        noise = np.maximum(prior.noise / prior.episodes, _LEAST_NOISE * spread)
        kernel, average_noise = self._kernel(self.archive, self.archive), float(noise.mean())
        self._jump = max(roughness(kernel, centred) - average_noise, 0.0) if jumps else 0.0
        signal = max(spread - average_noise - self._jump, _LEAST_NOISE * spread)
        gram = signal * kernel + np.diag(noise + self._jump)
        self._weights = (
            signal * np.linalg.solve(gram, centred.T) if spread else np.zeros_like(centred.T)
        )
        variance = float(self.task_means(self.archive).var(axis=0, ddof=1).mean())
        self._residual = residual * variance
        self._extremes = np.stack([prior.excess.min(axis=0), prior.excess.max(axis=0)])

    @property
    def num_tasks(self) -> int:
        """T, the number of training tasks."""
        return len(self.prior.excess)

    def task_means(self, latents: FloatArray) -> FloatArray:
        """Return x_i(z), the excess in each training task, `[task, point]`."""
        return self._average + (self._kernel(latents, self.archive) @ self._weights).T

    def noise(self, latents: FloatArray) -> FloatArray:
        """Return the variance of one episode's return, averaged over near latents, `[point]`."""
        kernel = self._kernel(latents, self.archive) + np.finfo(np.float64).tiny
        average: FloatArray = kernel @ self.prior.noise / kernel.sum(axis=1)
        return average

    def covariance(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return R(z, z'), the covariance of residual and jumps, `[first, second]`."""
        same = (first[:, None] == second[None]).all(axis=-1)
        return self._residual * self._kernel(first, second) + self._jump * same

    def explained(self, length: float = 1.0) -> tuple[float, float]:
        """Return the smallest and the largest return of one episode that the prior explains.

        Args:
            length: l, steps of the episode as a share of the horizon.
        """
        prior = self.prior
        std = np.sqrt(prior.noise + self._residual + self._jump + (length * prior.offset_std) ** 2)
        low, high = self._extremes + length * prior.offset_mean
        return float((low - BEYOND * std).min()), float((high + BEYOND * std).max())

    def _kernel(self, first: FloatArray, second: FloatArray) -> FloatArray:
        return matern(first, second, self._length_scale)


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


@dataclass(frozen=True)
class Posterior:
    """The posterior of f at some latents, given some readings.

    The components of the mixture, one per training task, share one covariance. Let L be the
    Cholesky factor of the covariance of the readings. The posterior keeps L^-1 cov(readings, f) and
    L^-1 cov(readings, c). A further reading adds one row to each and changes no other.

    Attributes:
        points: the latents, `[point, z]`.
        task_mean: mean of f if the new task is like training task i, `[task, point]`.
        task_offset: mean of c if the new task is like training task i, `[task]`.
        variance: variance of f in each component, `[point]`.
        rows: L^-1 cov(readings, f), `[reading, point]`.
        offset_rows: L^-1 cov(readings, c), `[reading]`.
        readings: the readings so far.
        scales: diagonal of L, the predicted standard deviation of each reading given those before
            it, `[reading]`.
        innovations: each reading minus its prediction in each component, divided by its scale,
            `[reading, task]`.
    """

    points: FloatArray
    task_mean: FloatArray
    task_offset: FloatArray
    variance: FloatArray
    rows: FloatArray
    offset_rows: FloatArray
    readings: tuple[Reading, ...]
    scales: FloatArray
    innovations: FloatArray

    @staticmethod
    def of_prior(model: ReturnModel, points: FloatArray) -> "Posterior":
        """Return the distribution at some latents before any reading."""
        return Posterior(
            points,
            model.task_means(points),
            np.full(model.num_tasks, model.prior.offset_mean),
            model.covariance(points[:1], points[:1])[0, 0] * np.ones(len(points)),
            rows=np.zeros((0, len(points))),
            offset_rows=np.zeros(0),
            readings=(),
            scales=np.zeros(0),
            innovations=np.zeros((0, model.num_tasks)),
        )

    @property
    def task_weights(self) -> FloatArray:
        """Posterior probability that the new task is like each training task, `[task]`."""
        log_weights = -0.5 * (self.innovations**2).sum(axis=0)
        weights = np.exp(log_weights - log_weights.max())
        return np.asarray(weights / weights.sum())

    @property
    def mean(self) -> FloatArray:
        """Mean of f, `[point]`."""
        return np.asarray(self.task_weights @ self.task_mean)

    @property
    def std(self) -> FloatArray:
        """Standard deviation of f, `[point]`."""
        between = self.task_weights @ (self.task_mean - self.mean) ** 2
        return np.sqrt(between + np.maximum(self.variance, 0.0))

    def expected(self, point: int) -> Reading:
        """Return the reading that is expected of a whole episode with a latent."""
        predicted = self.task_mean[:, point] + self.task_offset
        return Reading(point, float(self.task_weights @ predicted))

    def is_known(self, model: ReturnModel, point: int) -> bool:
        """Whether a latent would return what it returned before: its episodes have no noise."""
        played = any(one.point == point for one in self.readings)
        z = self.points[point : point + 1]
        return played and float(model.noise(z)[0]) <= KNOWN * float(model.covariance(z, z)[0, 0])

    def conditioned(self, model: ReturnModel, reading: Reading) -> "Posterior":
        """Return the posterior with one more reading: one step of a Cholesky decomposition."""
        j, length = reading.point, reading.length
        point = self.points[j : j + 1]
        # Covariances of this reading with f, with c and with itself, given the readings before.
        reading_row = self.rows[:, j] + length * self.offset_rows
        covariance = model.covariance(point, self.points)[0] - reading_row @ self.rows
        offset = length * model.prior.offset_std**2 - float(reading_row @ self.offset_rows)
        variance = float(covariance[j]) + length * offset + float(model.noise(point)[0])
        error = reading.episode_return - (self.task_mean[:, j] + length * self.task_offset)
        if self.is_known(model, j):
            scale = np.inf  # it teaches nothing, so its row is zero
        else:
            scale = max(float(np.sqrt(variance)), float(np.abs(error).min()) / OUTLIER)
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

    def extended(self, model: ReturnModel, more: FloatArray) -> "Posterior":
        """Return the posterior at its latents and at some more."""
        rows = np.zeros((len(self.readings), len(more)))
        for index, reading in enumerate(self.readings):
            j, length = reading.point, reading.length
            reading_row = self.rows[:index, j] + length * self.offset_rows[:index]
            covariance = model.covariance(self.points[j : j + 1], more)[0]
            rows[index] = (covariance - reading_row @ rows[:index]) / self.scales[index]
        before = Posterior.of_prior(model, more)
        task_mean = before.task_mean + self.innovations.T @ rows
        variance = before.variance - (rows**2).sum(axis=0)
        return replace(
            self,
            points=np.concatenate([self.points, more]),
            task_mean=np.hstack([self.task_mean, task_mean]),
            variance=np.append(self.variance, variance),
            rows=np.hstack([self.rows, rows]),
        )
