"""The controls of a search: a process that knows no task, and latents drawn at random."""

from pathlib import Path

import numpy as np
import pytest
from small_runs import tiny_maesn, tiny_settings

from maesn import api
from maesn.rules import RandomRule, StationaryRule, Trained
from maesn.runs.run import Run
from maesn.runtime.kernel import matern
from maesn.search import PriorSettings
from maesn.search.stored import run_prior


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return Run.create(tmp_path_factory.mktemp("controls") / "run", tiny_maesn(), tiny_settings())


def test_a_stationary_process_knows_the_mean_of_the_tasks_and_none_of_them(run: Run) -> None:
    _, prior = run_prior(run, PriorSettings(draws=6, adapted=False, episodes=2))
    trained = Trained(run.learner, run.latest_state(), lambda path, any_reward: prior)
    learner = StationaryRule().fast_learner(trained, run.env())
    model, known = learner.model, learner.settings.model(prior)
    assert model.num_tasks == 1
    mean = known.task_means(prior.latents).mean(axis=0)
    np.testing.assert_allclose(model.task_means(prior.latents)[0], mean)
    z, shift = prior.latents[:1], np.float64([[0.3, -2.0]])
    alike = matern(z, z + shift, 1.0)[0, 0]
    variance = known.task_means(prior.latents).var(axis=0, ddof=1).mean()
    for place in (z, z + 10.0):
        found = model.covariance(place, np.concatenate([place + shift, place - shift]))[0]
        np.testing.assert_allclose(found, variance * alike)
    assert learner.settings.familiar == 1.0


def test_the_best_of_random_latents_is_deployed(run: Run, tmp_path: Path) -> None:
    few = {"num_tasks": 5, "episodes": 6, "reward": "dense", "out": tmp_path / "table.csv"}
    outcome = api.adapt(run, rule=RandomRule(), **few).outcome
    latents, returns = outcome.contexts.mean, outcome.explored.mean_return
    for z, played in zip(latents, returns, strict=True):
        best = [np.argmax(played[:k]) for k in range(1, 7)]
        is_new = np.flatnonzero(np.diff([-1, *best]))
        assert is_new.tolist() == np.flatnonzero((z[1:] != z[:-1]).any(axis=-1)).tolist()
    wide = api.adapt(run, rule=RandomRule(spread=2.0), **few).outcome.contexts.mean
    np.testing.assert_allclose(wide[:, 1], 2.0 * latents[:, 1], rtol=1e-6)  # the first is kept
    assert (latents[:, 1].std(axis=0) > 0.1).all()  # each task has its own
