"""A Gaussian process over latents: what a new task may return, as training tasks have shown it.

In a new task, an episode with latent z returns

    y = f(z) + l c + noise,     f ~ GP(m, K),     c ~ N(offset_mean, offset_std^2),

where c is what an episode of full length returns that never comes near the goal, and l is how long
the episode lasted, as a share of the horizon. `docs/methods/latent_search.md` has the equations.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from maesn.runtime.arrays import FloatArray

# A return this many standard deviations away from what was expected counts as an outlier: it is
# taken for a reading with so much noise that it is just this far away.
OUTLIER = 4.0
# Added to the kernel matrix that interpolates between latents, so that duplicates do not make it
# singular.
_JITTER = 1e-2


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


@dataclass(frozen=True)
class Points:
    """Latents, and how each interpolates the archive.

    Attributes:
        latents: `[point, z]`.
        weights: of the archive's latents, `[point, latent]`.
    """

    latents: FloatArray
    weights: FloatArray

    def __len__(self) -> int:
        return len(self.latents)

    def joined(self, other: "Points") -> "Points":
        """Return these points and then the others."""
        return Points(
            np.concatenate([self.latents, other.latents]),
            np.concatenate([self.weights, other.weights]),
        )

    def __getitem__(self, index: int) -> "Points":
        return Points(self.latents[index : index + 1], self.weights[index : index + 1])


class ReturnModel:
    """The Gaussian process of a prior, at any latents.

    Between the archive's latents, mean and covariance over training tasks are interpolated:
    with w(z) = k(z, Z) k(Z, Z)^-1 and k the stationary kernel,

        m(z) = w(z) m,     K(z, z') = w(z) S w(z')^T + residual k(z, z'),

    where S is the covariance of X over training tasks, its diagonal less the Monte-Carlo variance
    of X, and negative eigenvalues set to 0.

    Args:
        prior: of the policy.
        residual: variance of what no training task shows, as a share of the mean variance over
            training tasks.
        length_scale: distance in z over which that varies.
    """

    def __init__(self, prior: ReturnPrior, residual: float, length_scale: float) -> None:
        self.prior = prior
        self._length_scale = length_scale
        centred = prior.excess - prior.excess.mean(axis=0)
        sampled = centred.T @ centred / (len(centred) - 1)
        self._covariance = positive(sampled - np.diag(prior.noise / prior.episodes))
        self._residual = residual * float(np.diag(self._covariance).mean())
        gram = matern(prior.latents, prior.latents, length_scale)
        self._inverse = np.linalg.inv(gram + _JITTER * np.eye(len(gram)))
        self._mean = prior.excess.mean(axis=0)
        self.archive = Points(prior.latents, np.eye(len(prior.latents)))

    def points(self, latents: FloatArray) -> Points:
        """Return latents `[point, z]` as points."""
        kernel = matern(latents, self.prior.latents, self._length_scale)
        return Points(latents, kernel @ self._inverse)

    def mean(self, points: Points) -> FloatArray:
        """Return m(z), `[point]`."""
        # What is far from every latent of the archive returns what latents return on average.
        average = self._mean.mean()
        return average + points.weights @ (self._mean - average)

    def noise(self, points: Points) -> FloatArray:
        """Return the variance of one episode's return, `[point]`."""
        average = self.prior.noise.mean()
        interpolated = average + points.weights @ (self.prior.noise - average)
        return np.maximum(interpolated, self.prior.noise.min())

    def covariance(self, first: Points, second: Points) -> FloatArray:
        """Return K(z, z'), `[first, second]`."""
        kernel = matern(first.latents, second.latents, self._length_scale)
        shared = first.weights @ self._covariance @ second.weights.T
        return shared + self._residual * kernel

    def variance(self, points: Points) -> FloatArray:
        """Return K(z, z), `[point]`."""
        shared = ((points.weights @ self._covariance) * points.weights).sum(axis=1)
        return shared + self._residual


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
    """What is known of f at some points, and of c, after some readings.

    Rows of the inverse Cholesky factor times the covariances are kept, one for each reading, so
    that a reading costs no more than a row.

    Attributes:
        mean: of f, `[point]`.
        variance: of f, `[point]`.
        offset_mean: of c.
        offset_variance: of c.
        rows: `[reading, point]`.
        offset_rows: the same of c, `[reading]`.
        readings: those that it is conditioned on.
        scales: standard deviation that was expected of each reading, `[reading]`.
        innovations: each reading less what was expected, in these standard deviations, `[reading]`.
    """

    mean: FloatArray
    variance: FloatArray
    offset_mean: float
    offset_variance: float
    rows: FloatArray
    offset_rows: FloatArray = field(default_factory=lambda: np.zeros(0))
    readings: tuple[Reading, ...] = ()
    scales: FloatArray = field(default_factory=lambda: np.zeros(0))
    innovations: FloatArray = field(default_factory=lambda: np.zeros(0))

    @staticmethod
    def of_prior(model: ReturnModel, points: Points) -> "Posterior":
        """Return what is known before any reading."""
        return Posterior(
            model.mean(points),
            model.variance(points),
            model.prior.offset_mean,
            model.prior.offset_std**2,
            np.zeros((0, len(points))),
        )

    @property
    def std(self) -> FloatArray:
        """Standard deviation of f, `[point]`."""
        return np.sqrt(np.maximum(self.variance, 0.0))

    def conditioned(self, model: ReturnModel, points: Points, reading: Reading) -> "Posterior":
        """Return the posterior with one more reading: one step of a Cholesky decomposition."""
        j, share = reading.point, reading.length
        seen = self.rows[:, j] + share * self.offset_rows
        covariance = model.covariance(points[j], points)[0] - seen @ self.rows
        offset = share * model.prior.offset_std**2 - float(seen @ self.offset_rows)
        spread = float(covariance[j]) + share * offset + float(model.noise(points[j])[0])
        spread = max(spread, np.finfo(np.float64).tiny)
        surprise = reading.episode_return - (self.mean[j] + share * self.offset_mean)
        scale = max(np.sqrt(spread), abs(surprise) / OUTLIER)
        innovation = surprise / scale
        row, offset_row = covariance / scale, offset / scale
        return replace(
            self,
            mean=self.mean + row * innovation,
            variance=self.variance - row**2,
            offset_mean=self.offset_mean + offset_row * innovation,
            offset_variance=self.offset_variance - offset_row**2,
            rows=np.vstack([self.rows, row]),
            offset_rows=np.append(self.offset_rows, offset_row),
            readings=(*self.readings, reading),
            scales=np.append(self.scales, scale),
            innovations=np.append(self.innovations, innovation),
        )

    def extended(self, model: ReturnModel, points: Points, more: Points) -> "Posterior":
        """Return the posterior at the points and at some more.

        Args:
            model: of the returns.
            points: those of this posterior.
            more: the others.
        """
        rows = np.zeros((len(self.readings), len(more)))
        for index, reading in enumerate(self.readings):
            seen = self.rows[:index, reading.point] + reading.length * self.offset_rows[:index]
            covariance = model.covariance(points[reading.point], more)[0] - seen @ rows[:index]
            rows[index] = covariance / self.scales[index]
        return replace(
            self,
            mean=np.append(self.mean, model.mean(more) + self.innovations @ rows),
            variance=np.append(self.variance, model.variance(more) - (rows**2).sum(axis=0)),
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


def positive(matrix: FloatArray) -> FloatArray:
    """Return the nearest symmetric matrix without negative eigenvalues."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2.0)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T
