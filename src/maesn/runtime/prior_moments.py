"""Mean and covariance of returns in a new task, as other libraries take a prior."""

from typing import NamedTuple

from maesn.runtime.arrays import FloatArray
from maesn.runtime.return_model import ReturnModel


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

    Args:
        model: the model of returns, as `ExportedSearch.model`.
        latents: `[point, z]`, distinct from each other.
    """
    tasks = model.task_means(latents)
    centred = tasks - tasks.mean(axis=0)
    between = centred.T @ centred / len(tasks)
    return Moments(
        tasks.mean(axis=0) + model.prior.offset_mean,
        between + model.covariance(latents, latents) + model.prior.offset_std**2,
        model.noise(latents),
    )
