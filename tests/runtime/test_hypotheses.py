"""What a new task may be: Bayes' rule over hypotheses, by brute force, and true quantiles."""

from dataclasses import replace

import numpy as np
import pytest
from runtime.test_return_model import model_of, random_prior, random_readings
from scipy.stats import multivariate_normal, norm

from maesn.runtime.hypotheses import MixedPosterior, normal_cdf
from maesn.runtime.posterior import Reading
from maesn.runtime.return_model import ReturnModel, ReturnPrior
from maesn.runtime.search import LatentSearch, SearchSettings

FAMILIAR = 0.7


def believed(model: ReturnModel, readings: list[Reading]) -> MixedPosterior:
    posterior = MixedPosterior.of_prior(model, FAMILIAR)
    for reading in readings:
        posterior = posterior.conditioned(reading)
    return posterior


@pytest.mark.parametrize("seed", range(4))
def test_hypotheses_are_weighed_by_the_density_of_all_readings(seed: int) -> None:
    model = model_of(random_prior(seed, tasks=5, noise=30.0))
    readings = random_readings(model, 8, seed)
    points = np.array([one.point for one in readings])
    length = np.array([one.length for one in readings])
    values = np.array([one.episode_return for one in readings])
    at, densities = model.archive[points], []
    for one, probability in (
        (model, FAMILIAR),
        (model.shifted(), (1 - FAMILIAR) / 2),
        (model.unlike(), (1 - FAMILIAR) / 2),
    ):
        covariance = (
            one.covariance(at, at)
            + one.prior.offset_std**2 * np.outer(length, length)
            + np.diag(one.noise(at))
        )
        means = one.task_means(at) + one.prior.offset_mean * length
        densities += [
            probability / one.num_tasks * multivariate_normal.pdf(values, mean, covariance)
            for mean in means
        ]
    posterior = believed(model, readings)
    expected = np.asarray(densities) / np.sum(densities)
    np.testing.assert_allclose(posterior.weights, expected, rtol=1e-6, atol=1e-12)
    assert posterior.familiar == pytest.approx(expected[:5].sum())
    means = np.concatenate([part.task_mean for part in posterior.parts])
    second = [part.task_mean**2 + np.maximum(part.variance, 0) for part in posterior.parts]
    np.testing.assert_allclose(posterior.mean, expected @ means, rtol=1e-6)
    variance = expected @ np.concatenate(second) - (expected @ means) ** 2
    np.testing.assert_allclose(posterior.std, np.sqrt(variance), rtol=1e-5)


def test_a_certain_search_has_one_hypothesis() -> None:
    alone = MixedPosterior.of_prior(model_of(random_prior(0)), 1.0)
    assert (len(alone.parts), alone.familiar) == (1, 1.0)


def test_the_normal_distribution_function_is_scipys() -> None:
    x = np.linspace(-9, 9, 50)
    np.testing.assert_allclose(normal_cdf(x), norm.cdf(x), rtol=1e-12)


@pytest.mark.parametrize("count", [0, 1, 6])
def test_quantiles_are_those_of_draws_from_the_mixture(count: int) -> None:
    model = model_of(random_prior(3))
    posterior = believed(model, random_readings(model, count, 3))
    levels = (0.05, 0.5, 0.95)
    quantiles = posterior.quantiles(4, levels)
    for level, value in zip(levels, quantiles, strict=True):
        assert posterior.place(Reading(4, value)) == pytest.approx(level, abs=1e-5)
    stream, number = np.random.default_rng(count), 200_000
    weights, means, stds = posterior.predicted(4)
    drawn = stream.choice(len(weights), number, p=weights)
    returns = means[drawn] + stds[drawn] * stream.standard_normal(number)
    for level, value in zip(levels, quantiles, strict=True):
        sigma = np.sqrt(level * (1 - level) / number)
        assert abs((returns < value).mean() - level) < 5 * sigma


def exact(latents: int) -> ReturnPrior:
    prior = random_prior(5, latents=latents, noise=0.0)
    return replace(prior, episodes=1, offset_std=0.0)


@pytest.mark.parametrize("latents", [1, 12])
def test_exact_returns_leave_everything_finite(latents: int) -> None:
    """Returns far from what the prior says, and the same latent twice."""
    prior, settings = exact(latents), SearchSettings()
    search = LatentSearch.start(settings.model(prior), settings)
    generator = np.random.default_rng(0)
    for value in (-300.0, -300.0, 40.0, 41.0):
        search, point = search.proposed(generator)
        search = search.after([Reading(point, value)] * 2)
        beliefs = search.beliefs
        for found in (*beliefs, search.posterior.weights):
            assert np.isfinite(found).all()
        assert search.interval(point) == (value, value)
    assert search.posterior.familiar < 0.5


def test_returns_that_never_vary_are_predicted_exactly() -> None:
    """As of a policy that never finds a goal, where nothing is random."""
    prior = exact(12)
    posterior = believed(model_of(replace(prior, excess=np.zeros_like(prior.excess))), [])
    assert posterior.quantiles(0, (0.05, 0.95)) == pytest.approx((-3.0, -3.0))
    places = [posterior.place(Reading(0, value)) for value in (-4.0, -3.0, -2.0)]
    assert places == pytest.approx([0.0, 0.5, 1.0])


def test_a_return_that_one_task_alone_explains_leaves_everything_finite() -> None:
    prior = replace(exact(1), excess=np.array([[1.0], [5.0]]))
    model = ReturnModel(prior, residual=0.0, length_scale=1.0, jumps=False)
    readings = [Reading(0, float(model.task_means(model.archive)[0, 0]) + prior.offset_mean)]
    posterior = believed(model, readings)
    assert np.isfinite(posterior.mean).all()
    assert np.isfinite(posterior.weights).all()


def test_a_task_at_another_level_is_noticed_and_solved() -> None:
    """Standing still returns there what the best latents return in training."""
    archive = np.linspace(-4, 4, 41)[:, None]
    peaks = np.linspace(-3, 3, 25)
    excess = 100 * np.exp(-2 * (archive[None, :, 0] - peaks[:, None]) ** 2)
    prior = ReturnPrior(archive, excess, np.full(41, 9.0), 4, offset_mean=-400.0, offset_std=0.1)
    generator = np.random.default_rng(0)
    reached = dict.fromkeys((FAMILIAR, 1.0), 0)
    for familiar in reached:
        settings = SearchSettings(draws=0, familiar=familiar)
        for target in (-2.6, -1.1, 0.2, 1.4, 2.7):
            value = 60 * np.exp(-2 * (archive[:, 0] - target) ** 2) - 310.0
            search = LatentSearch.start(settings.model(prior), settings)
            for _ in range(20):
                search, point = search.proposed(generator)
                noise = 3 * generator.standard_normal()
                search = search.after([Reading(point, float(value[point] + noise))])
            reached[familiar] += bool(value[search.best] > -310.0 + 40.0)
            assert familiar == 1.0 or search.posterior.familiar < 0.1
    assert reached[FAMILIAR] == 5
    assert reached[1.0] < 3
