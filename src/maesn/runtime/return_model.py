"""What a new task may return for a latent, as training tasks have shown it.

A new task is like one of the training tasks, up to a residual. With latent z an episode returns

    y = f(z) + l c + noise,     f ~ sum_i GP(x_i, R) / T,     c ~ N(offset_mean, offset_std^2),

where x_i is the excess return of training task i, c is what an episode of full length returns that
never comes near the goal, and l is how long the episode lasted, as a share of the horizon.
`docs/explanation/methods/latent_search.md` has the equations.
"""

from dataclasses import dataclass, replace

import numpy as np

from maesn.runtime.arrays import FloatArray

# A return this many standard deviations away from what every task leads to expect is an outlier: it
# is taken for a reading with so much noise that it is just this far away.
OUTLIER = 4.0
# Of the noise of the archive's returns, as a share of their variance: duplicates must not make the
# kernel matrix singular.
_LEAST_NOISE = 1e-6


@dataclass(frozen=True)
class ReturnPrior:
    """What training tasks return for an archive of latents.

    Attributes:
        latents: the archive z_1 ... z_N, `[latent, z]`.
        excess: X_ij, mean return of latent j in training task i, less what the same episodes would
            have returned had they never come near the goal, `[task, latent]`.
        noise: variance of the return of one episode, `[latent]`.
        episodes: number of episodes behind each X_ij.
        offset_mean: mean over training tasks of c.
        offset_std: its standard deviation.

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

    The excess of a training task is a smooth function of the latent of which the archive shows
    noisy values. With the stationary kernel k, their mean x, variance s^2 and noise d_j,

        x_i(z) = x + s^2 k(z, Z) [s^2 k(Z, Z) + diag(d)]^-1 (X_i - x).

    Args:
        prior: of the policy.
        residual: variance of R, what no training task shows, as a share of the mean variance over
            training tasks.
        length_scale: distance in z over which both vary.
    """

    def __init__(self, prior: ReturnPrior, residual: float, length_scale: float) -> None:
        self.prior = prior
        self.archive = prior.latents
        self._length_scale = length_scale
        self._average = float(prior.excess.mean())
        centred = prior.excess - self._average
        spread = float((centred**2).mean())
        noise = np.maximum(prior.noise / prior.episodes, _LEAST_NOISE * spread)
        signal = max(spread - float(noise.mean()), _LEAST_NOISE * spread)
        gram = signal * self._kernel(self.archive, self.archive) + np.diag(noise)
        self._weights = (
            signal * np.linalg.solve(gram, centred.T) if spread else np.zeros_like(centred.T)
        )
        variance = float(self.task_means(self.archive).var(axis=0, ddof=1).mean())
        self._residual = residual * variance

    @property
    def num_tasks(self) -> int:
        """T, the number of training tasks."""
        return len(self.prior.excess)

    def task_means(self, latents: FloatArray) -> FloatArray:
        """Return x_i(z), the excess in each training task, `[task, point]`."""
        return self._average + (self._kernel(latents, self.archive) @ self._weights).T

    def noise(self, latents: FloatArray) -> FloatArray:
        """Return the variance of one episode's return, that of near latents, `[point]`."""
        kernel = self._kernel(latents, self.archive) + np.finfo(np.float64).tiny
        near: FloatArray = kernel @ self.prior.noise / kernel.sum(axis=1)
        return near

    def covariance(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return R(z, z'), `[first, second]`."""
        return self._residual * self._kernel(first, second)

    def _kernel(self, first: FloatArray, second: FloatArray) -> FloatArray:
        return matern(first, second, self._length_scale)


@dataclass(frozen=True)
class Reading:
    """One observed return.

    Attributes:
        point: index of the latent that was played.
        episode_return: y.
        length: l, steps of the episode as a share of the horizon.
    """

    point: int
    episode_return: float
    length: float = 1.0


@dataclass(frozen=True)
class Posterior:
    """What is known of f at some latents after some readings.

    All components of the mixture have one covariance. Of it, rows of the inverse Cholesky factor
    times the covariances are kept, one for each reading, so that a reading costs no more than a
    row.

    Attributes:
        points: the latents, `[point, z]`.
        task_mean: mean of f if the new task is like training task i, `[task, point]`.
        task_offset: mean of c likewise, `[task]`.
        variance: of f in each of these cases, `[point]`.
        rows: `[reading, point]`.
        offset_rows: the same of c, `[reading]`.
        readings: those that it is conditioned on.
        scales: standard deviation that was expected of each reading, `[reading]`.
        innovations: each reading less what was expected, in these standard deviations,
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
        """Return what is known at some latents before any reading."""
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
        """How probable it is that the new task is like each training task, `[task]`."""
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

    def conditioned(self, model: ReturnModel, reading: Reading) -> "Posterior":
        """Return the posterior with one more reading: one step of a Cholesky decomposition."""
        j, share = reading.point, reading.length
        point = self.points[j : j + 1]
        seen = self.rows[:, j] + share * self.offset_rows
        covariance = model.covariance(point, self.points)[0] - seen @ self.rows
        offset = share * model.prior.offset_std**2 - float(seen @ self.offset_rows)
        spread = float(covariance[j]) + share * offset + float(model.noise(point)[0])
        surprise = reading.episode_return - (self.task_mean[:, j] + share * self.task_offset)
        least = np.finfo(np.float64).tiny
        scale = max(float(np.sqrt(max(spread, least))), float(np.abs(surprise).min()) / OUTLIER)
        innovation, row, offset_row = surprise / scale, covariance / scale, offset / scale
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
            point = self.points[reading.point : reading.point + 1]
            seen = self.rows[:index, reading.point] + reading.length * self.offset_rows[:index]
            covariance = model.covariance(point, more)[0] - seen @ rows[:index]
            rows[index] = covariance / self.scales[index]
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


def matern(first: FloatArray, second: FloatArray, length_scale: float) -> FloatArray:
    """Return the Matern kernel with nu = 5/2 and variance 1, `[first, second]`.

    With r the Euclidean distance over the length scale:
    k = (1 + sqrt(5) r + 5 r^2 / 3) exp(-sqrt(5) r)  (Rasmussen and Williams 2006, equation 4.17).
    """
    distance = np.linalg.norm(first[:, None] - second[None], axis=-1)
    scaled = np.sqrt(5.0) * distance / length_scale
    return (1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled)
