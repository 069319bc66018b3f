"""The control of a search: a process that knows no task."""

import numpy as np
import pytest
from small_runs import tiny_maesn, tiny_settings

from maesn.rules import StationaryRule, Trained
from maesn.runs.run import Run
from maesn.runtime.return_model import matern
from maesn.search import PriorSettings
from maesn.search.stored import run_prior


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return Run.create(tmp_path_factory.mktemp("controls") / "run", tiny_maesn(), tiny_settings())


def test_a_stationary_process_knows_the_mean_of_the_tasks_and_none_of_them(run: Run) -> None:
    _, prior = run_prior(run, PriorSettings(draws=6, adapted=False, episodes=2, searches=0))
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
