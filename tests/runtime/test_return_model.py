"""The Gaussian process over latents, against an independent library and closed forms."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Kernel, Matern

from maesn.runtime.arrays import FloatArray
from maesn.runtime.return_model import (
    OUTLIER,
    Points,
    Posterior,
    Reading,
    ReturnModel,
    ReturnPrior,
    matern,
    positive,
)


def random_prior(
    seed: int, latents: int = 12, tasks: int = 30, size: int = 2, noise: float = 0.5
) -> ReturnPrior:
    stream = np.random.default_rng(seed)
    features = stream.standard_normal((tasks, 4)) @ stream.standard_normal((4, latents))
    return ReturnPrior(
        latents=2.0 * stream.standard_normal((latents, size)),
        excess=10.0 * features + stream.standard_normal((tasks, latents)),
        noise=np.full(latents, noise),
        episodes=4,
        offset_mean=-3.0,
        offset_std=2.0,
    )


def model_of(prior: ReturnPrior) -> ReturnModel:
    return ReturnModel(prior, residual=0.2, length_scale=1.5)


def random_readings(model: ReturnModel, number: int, seed: int) -> list[Reading]:
    """Draw a task from the process, and returns of points in it, with repetition."""
    stream, archive = np.random.default_rng(seed), model.archive
    covariance = model.covariance(archive, archive)
    task = stream.multivariate_normal(model.mean(archive), covariance, method="eigh")
    offset = stream.normal(model.prior.offset_mean, model.prior.offset_std)
    points, length = stream.integers(len(archive), size=number), stream.uniform(0.3, 1.0, number)
    noise = np.sqrt(model.noise(archive)[points]) * stream.standard_normal(number)
    returns = task[points] + length * offset + noise
    return [Reading(*one) for one in zip(points.tolist(), returns, length, strict=True)]


def posterior_of(model: ReturnModel, readings: list[Reading]) -> Posterior:
    posterior = Posterior.of_prior(model, model.archive)
    for reading in readings:
        posterior = posterior.conditioned(model, model.archive, reading)
    return posterior


class SharedKernel(Kernel):  # type: ignore[misc]
    """K(z_i, z_j) + l l' offset_std^2 of inputs (i, l), for scikit-learn."""

    def __init__(self, covariance: FloatArray, offset_std: float) -> None:
        self.covariance = covariance
        self.offset_std = offset_std

    def __call__(self, X: FloatArray, Y: FloatArray | None = None) -> FloatArray:
        other = X if Y is None else Y
        rows, columns = X[:, 0].astype(int), other[:, 0].astype(int)
        shared: FloatArray = self.covariance[np.ix_(rows, columns)]
        return shared + self.offset_std**2 * np.outer(X[:, 1], other[:, 1])

    def diag(self, X: FloatArray) -> FloatArray:
        return np.diag(self(X))

    def is_stationary(self) -> bool:
        return False


@pytest.mark.parametrize("noise", [4.0, 1e-4], ids=["noisy", "nearly exact"])
@pytest.mark.parametrize("seed", range(5))
def test_mean_and_variance_are_scikit_learns(seed: int, noise: float) -> None:
    """Readings repeat latents, and the archive holds one latent twice."""
    prior = random_prior(seed, noise=noise)
    prior.latents[1] = prior.latents[0]
    prior.excess[:, 1] = prior.excess[:, 0]
    model = model_of(prior)
    readings = random_readings(model, 25, seed)
    posterior = posterior_of(model, readings)
    assert np.abs(posterior.innovations).max() < OUTLIER

    archive = model.archive
    covariance = model.covariance(archive, archive)
    inputs = np.asarray([[reading.point, reading.length] for reading in readings])
    expected_mean = model.mean(archive)[inputs[:, 0].astype(int)] + prior.offset_mean * inputs[:, 1]
    values = np.asarray([reading.episode_return for reading in readings]) - expected_mean
    process = GaussianProcessRegressor(
        SharedKernel(covariance, prior.offset_std), alpha=noise, optimizer=None
    ).fit(inputs, values)
    without_offset = np.stack([np.arange(len(archive)), np.zeros(len(archive))], axis=1)
    mean, std = process.predict(without_offset, return_std=True)

    scale = np.sqrt(np.diag(covariance)).max()
    np.testing.assert_allclose(posterior.mean, model.mean(archive) + mean, atol=1e-6 * scale)
    np.testing.assert_allclose(posterior.variance, std**2, atol=1e-6 * scale**2)
    evidence = -0.5 * (posterior.innovations**2 + np.log(2 * np.pi * posterior.scales**2)).sum()
    assert evidence == pytest.approx(process.log_marginal_likelihood_value_, rel=1e-6)


def test_the_stationary_kernel_is_scikit_learns() -> None:
    stream = np.random.default_rng(0)
    first, second = stream.standard_normal((7, 3)), stream.standard_normal((5, 3))
    expected = Matern(length_scale=0.7, nu=2.5)(first, second)
    np.testing.assert_allclose(matern(first, second, 0.7), expected, rtol=1e-12)


def test_the_offset_is_learned_as_a_common_shift() -> None:
    """With f known exactly, c has the posterior of a normal mean, in closed form."""
    prior = replace(random_prior(1), excess=np.ones((5, 12)))
    model = ReturnModel(prior, residual=0.0, length_scale=1.0)
    posterior = posterior_of(model, [Reading(0, 2.0), Reading(3, 1.0), Reading(3, 0.0)])
    precision = 1 / prior.offset_std**2 + 3 / prior.noise[0]
    mean = (prior.offset_mean / prior.offset_std**2 + (1 + 0 - 1) / prior.noise[0]) / precision
    assert posterior.offset_mean == pytest.approx(mean)
    assert posterior.offset_variance == pytest.approx(1 / precision)
    np.testing.assert_allclose(posterior.mean, 1.0, atol=1e-9)


def test_more_points_change_nothing_and_agree_with_having_been_there_from_the_start() -> None:
    prior = random_prior(2)
    model = model_of(prior)
    more = model.points(np.random.default_rng(3).standard_normal((6, 2)))
    readings = random_readings(model, 10, 4)
    late = posterior_of(model, readings).extended(model, model.archive, more)
    points = model.archive.joined(more)
    early = Posterior.of_prior(model, points)
    for reading in readings:
        early = early.conditioned(model, points, reading)
    for name in ("mean", "variance", "rows"):
        np.testing.assert_allclose(getattr(late, name), getattr(early, name), atol=1e-9)


def test_a_point_on_the_archive_has_nearly_the_archives_values() -> None:
    """Interpolation smooths a little: X is known up to noise."""
    model = model_of(random_prior(5))
    again = model.points(model.prior.latents[:3])
    scale = np.sqrt(model.variance(model.archive).max())
    np.testing.assert_allclose(model.mean(again), model.mean(model.archive)[:3], atol=0.1 * scale)


def test_far_from_the_archive_only_the_average_and_the_residual_are_known() -> None:
    prior = random_prior(6)
    model = model_of(prior)
    far = model.points(np.full((1, 2), 1e3))
    np.testing.assert_allclose(model.mean(far), prior.excess.mean())
    stationary = model.variance(far)[0]
    assert 0 < stationary < model.variance(model.archive).min()
    np.testing.assert_allclose(model.noise(far), prior.noise.mean())


def test_an_indefinite_covariance_is_made_the_nearest_that_is_not() -> None:
    """In closed form: of diag(2, -1) turned by 30 degrees, only the negative part goes."""
    angle = np.pi / 6
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    found = positive(turn @ np.diag([2.0, -1.0]) @ turn.T)
    np.testing.assert_allclose(found, turn @ np.diag([2.0, 0.0]) @ turn.T, atol=1e-12)


def test_noise_larger_than_the_spread_over_tasks_leaves_a_sound_process() -> None:
    """The diagonal less the Monte-Carlo variance is negative here."""
    prior = replace(random_prior(7), noise=np.full(12, 1e5))
    model = ReturnModel(prior, residual=1e-3, length_scale=1.0)
    posterior = posterior_of(model, random_readings(model, 20, 8))
    assert np.isfinite(posterior.mean).all()
    assert posterior.variance.min() >= -1e-9


def test_an_outlier_moves_beliefs_no_more_than_the_limit() -> None:
    model = model_of(random_prior(9))
    start = Posterior.of_prior(model, model.archive)
    far, farther = (
        start.conditioned(model, model.archive, Reading(0, value)) for value in (-1e6, -1e12)
    )
    for posterior in (far, farther):
        assert abs(posterior.innovations[0]) == pytest.approx(OUTLIER)
        moved = np.abs(posterior.mean - start.mean)
        assert moved.max() < 1e-2
    assert np.isfinite(farther.mean).all()


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_beliefs_scale_with_the_rewards(factor: float) -> None:
    prior = random_prior(10)
    scaled = replace(
        prior,
        excess=factor * prior.excess,
        noise=factor**2 * prior.noise,
        offset_mean=factor * prior.offset_mean,
        offset_std=factor * prior.offset_std,
    )
    readings = random_readings(model_of(prior), 15, 11)
    larger = [replace(one, episode_return=factor * one.episode_return) for one in readings]
    plain = posterior_of(model_of(prior), readings)
    found = posterior_of(model_of(scaled), larger)
    np.testing.assert_allclose(found.mean, factor * plain.mean, rtol=1e-6)
    np.testing.assert_allclose(found.std, factor * plain.std, rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda p: replace(p, noise=p.noise[:-1]), "must have the shapes"),
        (lambda p: replace(p, excess=p.excess[:1]), "at least 2 tasks"),
        (lambda p: replace(p, excess=np.full_like(p.excess, np.nan)), "must be finite"),
        (lambda p: replace(p, noise=-p.noise), "`noise` must be at least 0"),
        (lambda p: replace(p, offset_std=-1.0), "`offset_std` must be at least 0"),
    ],
)
def test_a_prior_that_means_nothing_is_refused(
    change: Callable[[ReturnPrior], ReturnPrior], complaint: str
) -> None:
    with pytest.raises(ValueError, match=complaint):
        change(random_prior(0))


def test_points_are_rows() -> None:
    points = Points(np.arange(6.0).reshape(3, 2), np.eye(3))
    assert len(points) == 3
    np.testing.assert_array_equal(points[1].latents, [[2.0, 3.0]])
