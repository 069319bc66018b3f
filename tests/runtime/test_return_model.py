"""The Gaussian process over latents, against an independent library and closed forms."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Kernel, Matern

from maesn.runtime.arrays import FloatArray
from maesn.runtime.posterior import OUTLIER, Posterior, Reading
from maesn.runtime.return_model import (
    ROUGHNESS,
    ReturnModel,
    ReturnPrior,
    matern,
    moments,
    roughness,
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


def model_of(prior: ReturnPrior, *, jumps: bool = True) -> ReturnModel:
    return ReturnModel(prior, residual=0.2, length_scale=1.5, jumps=jumps)


def random_readings(model: ReturnModel, number: int, seed: int) -> list[Reading]:
    """Draw a task from the mixture, and returns of points in it, with repetition."""
    stream, archive = np.random.default_rng(seed), model.archive
    mean = model.task_means(archive)[stream.integers(model.num_tasks)]
    task = stream.multivariate_normal(mean, model.covariance(archive, archive), method="eigh")
    offset = stream.normal(model.prior.offset_mean, model.prior.offset_std)
    points, length = stream.integers(len(archive), size=number), stream.uniform(0.3, 1.0, number)
    noise = np.sqrt(model.noise(archive)[points]) * stream.standard_normal(number)
    returns = task[points] + length * offset + noise
    return [Reading(*one) for one in zip(points.tolist(), returns, length, strict=True)]


def posterior_of(model: ReturnModel, readings: list[Reading]) -> Posterior:
    posterior = Posterior.of_prior(model, model.archive)
    for reading in readings:
        posterior = posterior.conditioned(reading)
    return posterior


class SharedKernel(Kernel):  # type: ignore[misc]
    """R(z_i, z_j) + l l' offset_std^2 of inputs (i, l), for scikit-learn."""

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
def test_means_variances_and_weights_are_scikit_learns(seed: int, noise: float) -> None:
    """Readings repeat latents, and the archive holds one latent twice."""
    prior = random_prior(seed, tasks=4, noise=noise)
    prior.latents[1] = prior.latents[0]
    model = model_of(prior)
    readings = random_readings(model, 25, seed)
    posterior = posterior_of(model, readings)
    assert np.abs(posterior.innovations).min(axis=1).max() < OUTLIER

    archive = model.archive
    inputs = np.asarray([[reading.point, reading.length] for reading in readings])
    returns = np.asarray([reading.episode_return for reading in readings])
    without_offset = np.stack([np.arange(len(archive)), np.zeros(len(archive))], axis=1)
    covariance, noises = model.covariance(archive, archive), model.noise(archive)
    kernel = SharedKernel(covariance, prior.offset_std)
    scale, evidences = np.sqrt(covariance[0, 0]), []
    for task, mean in enumerate(model.task_means(archive)):
        points = inputs[:, 0].astype(int)
        values = returns - mean[points] - prior.offset_mean * inputs[:, 1]
        process = GaussianProcessRegressor(kernel, alpha=noises[points], optimizer=None)
        found, std = process.fit(inputs, values).predict(without_offset, return_std=True)
        tolerance = 1e-6 * np.abs(values).max()
        np.testing.assert_allclose(posterior.task_mean[task], mean + found, atol=tolerance)
        np.testing.assert_allclose(posterior.variance, std**2, atol=1e-6 * scale**2)
        evidences.append(process.log_marginal_likelihood_value_)
    weights = np.exp(np.asarray(evidences) - max(evidences))
    np.testing.assert_allclose(posterior.task_weights, weights / weights.sum(), atol=1e-6)


@pytest.mark.parametrize("noise", [4.0, 0.01])
def test_training_tasks_are_fitted_as_scikit_learn_does(noise: float) -> None:
    prior = random_prior(0, noise=noise)
    average = prior.excess.mean()
    spread = ((prior.excess - average) ** 2).mean()
    signal = spread - noise / prior.episodes
    process = GaussianProcessRegressor(
        ConstantKernel(signal) * Matern(length_scale=1.5, nu=2.5),
        alpha=noise / prior.episodes,
        optimizer=None,
    ).fit(prior.latents, (prior.excess - average).T)
    more = np.random.default_rng(1).standard_normal((7, 2))
    expected = average + process.predict(more).T
    found = model_of(prior, jumps=False).task_means(more)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_roughness_is_what_makes_each_left_out_latent_most_probable() -> None:
    """Against scikit-learn, which is fitted anew without each latent."""
    prior = random_prior(1, latents=9, tasks=6)
    centred = prior.excess - prior.excess.mean()
    spread = (centred**2).mean()
    scores = []
    for share in ROUGHNESS:
        kernel = ConstantKernel((1 - share) * spread) * Matern(length_scale=1.5, nu=2.5)
        score = 0.0
        for left_out in range(9):
            rest = np.delete(np.arange(9), left_out)
            process = GaussianProcessRegressor(kernel, alpha=share * spread, optimizer=None)
            process.fit(prior.latents[rest], centred[:, rest].T)
            mean, std = process.predict(prior.latents[[left_out]], return_std=True)
            variance = np.ravel(std)[0] ** 2 + share * spread
            error = centred[:, left_out] - mean[0]
            score += (error**2 / variance + np.log(variance)).mean()
        scores.append(score)
    kernel_matrix = matern(prior.latents, prior.latents, 1.5)
    expected = ROUGHNESS[np.argmin(scores)] * spread
    np.testing.assert_allclose(roughness(kernel_matrix, centred), expected, rtol=1e-9)


@pytest.mark.parametrize("share", [0.01, 0.2])
def test_roughness_finds_the_jumps_of_drawn_returns(share: float) -> None:
    """Within a factor of 1.5: 40 tasks of 150 latents know their variance to a few per cent."""
    stream = np.random.default_rng(5)
    latents = 2.0 * stream.standard_normal((150, 2))
    kernel = matern(latents, latents, 1.0)
    covariance = (1 - share) * kernel + share * np.eye(150)
    drawn = stream.multivariate_normal(np.zeros(150), covariance, 40)
    assert share / 1.5 < roughness(kernel, drawn) < share * 1.5


def exact_prior(latents: int = 12, **changes: Any) -> ReturnPrior:
    """A prior of episodes without noise, in tasks whose offsets differ."""
    return replace(random_prior(4, latents), noise=np.zeros(latents), episodes=1, **changes)


def test_without_noise_a_latent_that_was_played_is_known_and_teaches_nothing_more() -> None:
    model = model_of(exact_prior())
    once = posterior_of(model, random_readings(model, 6, 1))
    again = once
    for reading in once.readings:
        again = again.conditioned(reading)
    for name in ("task_mean", "task_weights", "std"):
        np.testing.assert_array_equal(getattr(again, name), getattr(once, name))
    np.testing.assert_array_equal(again.extended(1.0 + model.archive).mean[:12], once.mean)


@pytest.mark.parametrize("jumps", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_without_noise_an_equal_latent_teaches_nothing_more(seed: int, jumps: bool) -> None:
    prior = replace(random_prior(seed), noise=np.zeros(12), episodes=1)
    prior.latents[1], prior.excess[:, 1] = prior.latents[0], prior.excess[:, 0]
    model, returns = model_of(prior, jumps=jumps), prior.excess[3] + 4.0
    readings = [Reading(point, float(returns[point])) for point in (0, 5)]
    for one in (model, model.shifted(), model.unlike()):
        once = posterior_of(one, readings)
        again = once.conditioned(Reading(1, float(returns[1])))
        for name in ("task_mean", "task_weights", "std"):
            np.testing.assert_array_equal(getattr(again, name), getattr(once, name))


@pytest.mark.parametrize("offset_std", [0.0, 2.0])
def test_without_noise_everything_stays_finite_and_no_task_takes_all_the_weight(
    offset_std: float,
) -> None:
    model = model_of(exact_prior(offset_std=offset_std))
    stream = np.random.default_rng(2)
    # A task that is none of the training tasks.
    returns = model.prior.excess[:3].mean(axis=0) + 3.0 * stream.standard_normal(12)
    posterior = posterior_of(model, [Reading(j, returns[j] - 3.0) for j in range(12)])
    assert np.isfinite(posterior.mean).all()
    assert np.isfinite(posterior.std).all()
    assert posterior.task_weights.max() < 1 - 1e-6
    if not offset_std:
        np.testing.assert_allclose(posterior.mean, returns, atol=1e-6)


def test_mean_and_std_are_those_of_the_mixture() -> None:
    """Over draws: of a task by its weight, and of f in it, within 4.5 standard errors."""
    model = model_of(random_prior(3, tasks=5))
    posterior = posterior_of(model, random_readings(model, 3, 3))
    stream, number = np.random.default_rng(4), 200_000
    tasks = stream.choice(5, size=number, p=posterior.task_weights)
    noise = np.sqrt(posterior.variance[0]) * stream.standard_normal(number)
    drawn = posterior.task_mean[tasks, 0] + noise
    error = drawn.std() / np.sqrt(number)
    assert abs(drawn.mean() - posterior.mean[0]) < 4.5 * error
    assert posterior.std[0] == pytest.approx(drawn.std(), rel=0.02)


def test_the_offset_is_learned_as_a_common_shift() -> None:
    """With f known exactly, c has the posterior of a normal mean, in closed form."""
    prior = replace(random_prior(1), excess=np.ones((5, 12)))
    model = ReturnModel(prior, residual=0.0, length_scale=1.0)
    posterior = posterior_of(model, [Reading(0, 2.0), Reading(3, 1.0), Reading(3, 0.0)])
    precision = 1 / prior.offset_std**2 + 3 / prior.noise[0]
    mean = (prior.offset_mean / prior.offset_std**2 + (1 + 0 - 1) / prior.noise[0]) / precision
    np.testing.assert_allclose(posterior.task_offset, mean)
    np.testing.assert_allclose(posterior.mean, 1.0, atol=1e-9)


def test_more_points_change_nothing_and_agree_with_having_been_there_from_the_start() -> None:
    model = model_of(random_prior(2))
    more = np.random.default_rng(3).standard_normal((6, 2))
    readings = random_readings(model, 10, 4)
    late = posterior_of(model, readings).extended(more)
    early = Posterior.of_prior(model, np.concatenate([model.archive, more]))
    for reading in readings:
        early = early.conditioned(reading)
    for name in ("points", "task_mean", "variance", "rows"):
        np.testing.assert_allclose(getattr(late, name), getattr(early, name), atol=1e-9)


def test_far_from_the_archive_only_the_average_and_the_residual_are_known() -> None:
    prior = random_prior(6)
    model = model_of(prior)
    far = np.full((1, 2), 1e3)
    np.testing.assert_allclose(model.task_means(far), prior.excess.mean())
    np.testing.assert_allclose(model.noise(far), prior.noise.mean())
    assert Posterior.of_prior(model, far).std[0] == pytest.approx(
        np.sqrt(model.covariance(far, far)[0, 0])
    )


def test_an_outlier_moves_beliefs_no_more_than_the_limit() -> None:
    model = model_of(random_prior(9))
    start = Posterior.of_prior(model, model.archive)
    for value in (-1e6, -1e12):
        posterior = start.conditioned(Reading(0, value))
        assert np.abs(posterior.innovations).min() == pytest.approx(OUTLIER)
        assert np.abs(posterior.mean - start.mean).max() < 0.01 * start.std.max()


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
        (lambda p: replace(p, deployed_levels=(0.9, 0.1)), "levels must be between 0 and 1"),
    ],
)
def test_a_prior_that_means_nothing_is_refused(
    change: Callable[[ReturnPrior], ReturnPrior], complaint: str
) -> None:
    with pytest.raises(ValueError, match=complaint):
        change(random_prior(0))


def test_moments_are_those_of_the_mixture() -> None:
    """By second moments: E[y y'] = mean_i E[y y' | task i], y = f + c."""
    model = model_of(random_prior(1))
    points = np.random.default_rng(2).standard_normal((5, 2))
    found, prior = moments(model, points), model.prior
    tasks = model.task_means(points) + prior.offset_mean
    within = model.covariance(points, points) + prior.offset_std**2
    second = np.mean([np.outer(task, task) + within for task in tasks], axis=0)
    mean = tasks.mean(axis=0)
    np.testing.assert_allclose(found.mean, mean, rtol=1e-12)
    np.testing.assert_allclose(found.covariance, second - np.outer(mean, mean), rtol=1e-9)
    np.testing.assert_array_equal(found.noise, model.noise(points))


@pytest.mark.filterwarnings("ignore:overflow encountered")
def test_a_latent_at_an_infinite_distance_tells_nothing() -> None:
    assert matern(np.zeros((1, 2)), np.full((1, 2), 1e200), 1.0) == 0
