"""Intervals are corrected by searches in tasks that the prior does not know."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from small_runs import tiny_maesn, tiny_settings

from maesn.runs.run import Run
from maesn.runtime.return_model import NOMINAL
from maesn.search import PriorSettings, latent_of
from maesn.search.calibration import _levels, calibrated
from maesn.search.stored import run_prior


def test_levels_are_the_quantiles_that_were_hit() -> None:
    places = np.random.default_rng(0).permutation(np.linspace(0.2, 0.6, 401)).tolist()
    assert _levels(places, NOMINAL) == pytest.approx((0.22, 0.58))
    assert _levels(places[:99], (0.3, 0.5)) == (0.3, 0.5)
    assert _levels([0.5] * 400, (0.3, 0.6)) == (0.3, 0.6)
    assert _levels([0.0] * 100 + [1.0] * 100, NOMINAL) == pytest.approx((0.002, 0.998))


@pytest.mark.long
def test_intervals_that_are_too_wide_are_narrowed(tmp_path: Path) -> None:
    run = Run.create(tmp_path / "run", tiny_maesn(), tiny_settings())
    few = PriorSettings(draws=30, adapted=False, searches=10)
    _, prior = run_prior(run, few)
    assert tuple(prior.proposed_levels) != NOMINAL
    latent = latent_of(run.learner.fast_learner(run.latest_state()))
    wide = replace(prior, noise=1e4 * prior.noise)
    with closing(run.world(run.task_set("validation"), "sparse")) as world:
        found = calibrated(wide, latent, world, jax.random.key(0))
    for low, high in (found.proposed_levels, found.deployed_levels):
        assert low > 0.1
        assert high < 0.9
