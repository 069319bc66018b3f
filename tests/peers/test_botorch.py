"""The prior of a search as a model of BoTorch, and searches that it is compared with."""

from pathlib import Path
from typing import Any

import botorch_prior as example
import numpy as np
import pytest
import search_peers_methods as methods
import search_peers_rgpe
import torch
from botorch.acquisition import LogExpectedImprovement
from pages import blocks_of
from runtime.test_search import ARCHIVE_ALONE, NOISE, PRIOR, peak, targets
from scipy.stats import norm
from scripts import ROOT

import maesn
from maesn.runtime import moments

MODEL = ARCHIVE_ALONE.model(PRIOR)


def test_botorch_s_posterior_is_the_conditional_distribution_of_the_moments() -> None:
    prior, points, returns = moments(MODEL, PRIOR.latents), [3, 40, 3, 71], [-18.0, -20.0, -17.5, 2]
    posterior = example.ReturnGP(prior, points, returns).posterior(
        torch.arange(80.0)[:, None].double()
    )
    gram = prior.covariance[np.ix_(points, points)] + np.diag(prior.noise[points])
    gain = np.linalg.solve(gram, prior.covariance[points]).T
    mean = prior.mean + gain @ (returns - prior.mean[points])
    covariance = prior.covariance - gain @ prior.covariance[points]
    with torch.no_grad():
        np.testing.assert_allclose(posterior.mean[:, 0], mean, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(posterior.covariance_matrix, covariance, atol=1e-6)


def test_the_how_to_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    maesn.export("wheeled", "searcher.npz", rule=maesn.SearchRule())
    (code,) = blocks_of(ROOT / "docs" / "howto" / "botorch.md", "py")
    done: dict[str, Any] = {}
    exec(compile(code, "botorch.md", "exec"), done)
    assert done["following"] != done["points"][0]


def test_its_acquisition_is_the_expected_improvement_under_the_moments() -> None:
    prior, best = moments(MODEL, PRIOR.latents), -15.0
    model = example.ReturnGP(prior, [5], [-19.0])
    candidates = torch.arange(80, dtype=torch.float64)[:, None]
    with torch.no_grad():
        posterior = model.posterior(candidates)
        found = LogExpectedImprovement(model, best)(candidates[:, None]).exp()
        mean, std = posterior.mean[:, 0].numpy(), posterior.variance.sqrt()[:, 0].numpy()
    scaled = (mean - best) / std
    expected = std * norm.pdf(scaled) + (mean - best) * norm.cdf(scaled)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_the_ensemble_trusts_training_tasks_that_order_the_new_returns_as_they_are() -> None:
    """The new task is one of them, with other returns in the same order."""
    ensemble = search_peers_rgpe.Ensemble.of(
        torch.as_tensor(PRIOR.latents), torch.as_tensor(PRIOR.excess[:10])
    )
    points = np.argsort(PRIOR.excess[:4])[:, [-1, -5, -10, -20]]
    returns = np.exp(np.take_along_axis(PRIOR.excess[:4], points, 1) / 4)
    for task in range(4):
        mean, std, own = ensemble.predicted(points[task], returns[task])
        of_all = ensemble.means.mean(0)
        found = np.corrcoef([mean.numpy(), of_all.numpy(), ensemble.means[task].numpy()])[2]
        assert found[0] > max(0.8, found[1])
        assert (std > 0).all()
        assert own is not None


@pytest.mark.parametrize("method", range(6))
def test_every_search_improves_on_a_random_latent(method: int) -> None:
    goals, noise = targets(4, seed=2), np.random.default_rng(0)
    search = list(methods.METHODS.values())[method](methods.Known(MODEL), len(goals))
    value = np.stack([peak(PRIOR.latents, goal) for goal in goals])
    for _ in range(12):
        points = search.propose()
        returns = value[np.arange(4), points] - 20.0 + NOISE * noise.standard_normal(4)
        search.told(points, returns, np.ones(4))
    assert value[np.arange(4), search.best()].mean() > 2 * value.mean()


def test_of_two_tasks_at_once_each_is_searched_as_alone() -> None:
    prior = moments(MODEL, PRIOR.latents)
    points, returns = np.array([[3, 40], [9, 5]]), np.array([[-18.0, -20.0], [-19.0, -11.0]])
    candidates = torch.arange(80, dtype=torch.float64)[:, None]
    both, alone = [
        methods.best_of(
            example.ReturnGP(prior, points[part], returns[part]),
            candidates,
            torch.as_tensor(points[part])[..., None].double(),
        ).tolist()
        for part in (slice(None), slice(1, None))
    ]
    assert both[1:] == alone
