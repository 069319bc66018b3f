"""Models of the return of each latent in a new task, learned from the training tasks.

The return of an episode with latent z is

    y = f(z) + l c + noise,     f ~ (1/T) sum_i GP(x_i, R),     c ~ N(offset_mean, offset_std^2).

f is a uniform mixture of Gaussian processes, one per training task: x_i is the excess return in
training task i, and R the covariance of the residual. c is the return of a full-length episode that
never comes near the goal, and l the length of the episode as a share of the horizon.
`docs/explanation/methods/latent_search.md` has the equations.
"""

import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from maesn.runtime.arrays import FloatArray

# A return is beyond the prior if it is further from every return of the archive than this, in
# standard deviations. In 300 new tasks of the policies that come with the library, 15 episodes
# each, the furthest was at 1.3 (tests/long/test_surprise.py holds them below 2); rewards times 0.1
# are at 2.8 or more, except on `blockpush`, where they look like those of a solved task.
BEYOND = 2.0
# Lower bound on the noise of the archive's returns, as a share of their variance: two equal latents
# must not make the kernel matrix singular.
_LEAST_NOISE = 1e-6
# How many times farther returns vary in z where a task is unlike all training tasks. Chosen, as the
# other numbers of this hypothesis, on the task set `ood-validation` of `wheeled`.
_WIDER = 2.0
# Shares of the variance of the archive's returns that may be rough; the best of them is taken.
ROUGHNESS = np.geomspace(1e-4, 0.6, 20)

NOMINAL = (0.05, 0.95)
"""Quantiles between which 90 % of the returns lie if the model is right."""


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
        proposed_levels: the quantiles of the predicted return between which 90 % of the returns
            lie, for latents that a search plays, as found in searches in other tasks.
        deployed_levels: the same for latents that a search deploys. They are selected, so their
            returns tend to be below what was expected.

    Raises:
        ValueError: a field has another shape, is not finite, or is out of its range.
    """

    latents: FloatArray
    excess: FloatArray
    noise: FloatArray
    episodes: int
    offset_mean: float
    offset_std: float
    proposed_levels: tuple[float, ...] = NOMINAL
    deployed_levels: tuple[float, ...] = NOMINAL

    def __post_init__(self) -> None:
        count = self.noise.size
        shapes = (self.latents.shape[:1], self.excess.shape[1:], self.noise.shape)
        if self.latents.ndim != 2 or shapes != ((count,),) * 3 or count == 0:
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
        for low, high in (self.proposed_levels, self.deployed_levels):
            if not 0 < low < high < 1:
                raise ValueError(f"levels must be between 0 and 1, in order, got {low} and {high}.")


class ReturnModel:
    """A new task is like one of the T training tasks, up to a residual.

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

    Attributes:
        num_tasks: components of the mixture, one for each training task; 1 for `unlike`, whose only
            mean is the average over the training tasks.
        archive: the latents that a search chooses from, `[latent, z]`.
        residual: variance of R.
        reach: length scale of R.
    """

    def __init__(
        self, prior: ReturnPrior, residual: float, length_scale: float, jumps: bool = True
    ) -> None:
        self.prior = prior
        self.archive = prior.latents
        self.num_tasks = len(prior.excess)
        self._length_scale = self.reach = length_scale
        self._average = float(prior.excess.mean())
        centred = prior.excess - self._average
        spread = float((centred**2).mean())
        noise = np.maximum(prior.noise / prior.episodes, _LEAST_NOISE * spread)
        kernel, average_noise = self._kernel(self.archive, self.archive), float(noise.mean())
        self.jump = max(roughness(kernel, centred) - average_noise, 0.0) if jumps else 0.0
        signal = max(spread - average_noise - self.jump, _LEAST_NOISE * spread)
        gram = signal * kernel + np.diag(noise + self.jump)
        self._weights = (
            signal * np.linalg.solve(gram, centred.T) if spread else np.zeros_like(centred.T)
        )
        self._variance = float(self.task_means(self.archive).var(axis=0, ddof=1).mean())
        self.residual = residual * self._variance
        self._extremes = np.stack([prior.excess.min(axis=0), prior.excess.max(axis=0)])

    def task_means(self, latents: FloatArray) -> FloatArray:
        """Return x_i(z), the excess in each training task, `[task, point]`."""
        means = self._average + (self._kernel(latents, self.archive) @ self._weights).T
        return means.mean(axis=0, keepdims=True) if self.num_tasks == 1 else means

    def noise(self, latents: FloatArray) -> FloatArray:
        """Return the variance of one episode's return, averaged over near latents, `[point]`."""
        kernel = self._kernel(latents, self.archive) + np.finfo(np.float64).tiny
        average: FloatArray = kernel @ self.prior.noise / kernel.sum(axis=1)
        return average

    def covariance(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return R(z, z'), the covariance of residual and jumps, `[first, second]`."""
        same = (first[:, None] == second[None]).all(axis=-1)
        return self.residual * matern(first, second, self.reach) + self.jump * same

    @property
    def variance(self) -> float:
        """Variance of residual and jumps, R(z, z)."""
        return float(self.residual + self.jump)

    def explained(self, length: float = 1.0) -> tuple[float, float]:
        """Return the smallest and the largest return that the prior explains of an episode.

        Its length l is a share of the horizon.
        """
        prior = self.prior
        std = np.sqrt(prior.noise + self.residual + self.jump + (length * prior.offset_std) ** 2)
        low, high = self._extremes + length * prior.offset_mean
        return float((low - BEYOND * std).min()), float((high + BEYOND * std).max())

    def shifted(self) -> "ReturnModel":
        """Return the model of a task like a training task, whose c is unlike theirs."""
        other, widest = copy.copy(self), float(np.ptp(self.prior.excess))
        other.prior = replace(self.prior, offset_std=max(self.prior.offset_std, widest))
        return other

    def unlike(self, wider: float = _WIDER, *, shifted: bool = True) -> "ReturnModel":
        """Return the model of a task unlike all training tasks: one stationary Gaussian process.

        Its mean is that over the training tasks, and f varies over `wider` times the distance. c is
        as in `shifted`, or else as in the training tasks.
        """
        other = self.shifted() if shifted else copy.copy(self)
        other.num_tasks, other.residual = 1, self._variance
        other.reach = wider * self._length_scale
        return other

    def _kernel(self, first: FloatArray, second: FloatArray) -> FloatArray:
        return matern(first, second, self._length_scale)


class Moments(NamedTuple):
    """What whole episodes return in a new task, before any is played."""

    mean: FloatArray
    """`[point]`."""
    covariance: FloatArray
    """Of returns without the noise of an episode, `[point, point]`."""
    noise: FloatArray
    """Variance that the noise of one episode adds, `[point]`."""


def moments(model: ReturnModel, latents: FloatArray) -> Moments:
    """Return the moments of the mixture over training tasks, and of the unknown offset.

    By the law of total covariance, with f ~ (1/T) sum_i GP(x_i, R) and c the offset:

        mean = mean_i x_i + E[c],    covariance = cov_i(x_i) + R + var(c).

    The latents are `[point, z]`, distinct from each other.
    """
    tasks = model.task_means(latents)
    centred = tasks - tasks.mean(axis=0)
    between = centred.T @ centred / len(tasks)
    return Moments(
        tasks.mean(axis=0) + model.prior.offset_mean,
        between + model.covariance(latents, latents) + model.prior.offset_std**2,
        model.noise(latents),
    )


def roughness(kernel: FloatArray, centred: FloatArray) -> float:
    """Return the variance of the returns that near latents do not share: noise and jumps.

    The share of the variance that makes each latent's returns, predicted from those of all other
    latents, most probable (Rasmussen and Williams 2006, section 5.4.2).
    """
    spread = float((centred**2).mean())
    if not spread:
        return 0.0
    values, vectors = np.linalg.eigh(kernel)
    rotated, squares = vectors.T @ centred.T, vectors**2
    best, found = np.inf, 0.0
    for share in ROUGHNESS:
        inverse = 1.0 / (spread * ((1.0 - share) * np.maximum(values, 0.0) + share))
        precision = squares @ inverse
        error = (vectors @ (inverse[:, None] * rotated)) / precision[:, None]
        score = float((error**2 * precision[:, None]).mean() - np.log(precision).mean())
        if score < best:
            best, found = score, share * spread
    return found


def matern(first: FloatArray, second: FloatArray, length_scale: float) -> FloatArray:
    """Return the Matern kernel with nu = 5/2 and variance 1, `[first, second]`.

    With r the Euclidean distance over the length scale:
    k = (1 + sqrt(5) r + 5 r^2 / 3) exp(-sqrt(5) r)  (Rasmussen and Williams 2006, equation 4.17).
    """
    distance = np.linalg.norm(first[:, None] - second[None], axis=-1)
    # Beyond 1000 the exponential is 0, also where the distance is infinite.
    scaled = np.minimum(np.sqrt(5.0) * distance / length_scale, 1000.0)
    return (1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled)
