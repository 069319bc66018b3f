"""Statistics of comparisons against rliable, the library of the paper that defines them.

Ours draws the same tasks for all seeds, rliable draws seeds anew in each task. So numbers must be
equal everywhere, and intervals where there is one seed, or one task.
"""

import numpy as np
import pytest
from rliable import library, metrics

from maesn.reporting import statistics

RESAMPLES = 5000
# Ends of an interval of so many resamples scatter by about 2 % of its width; this is 5 sigma.
TOLERANCE = 0.1


@pytest.fixture
def scores() -> tuple[np.ndarray, np.ndarray]:
    """Two methods, `[seed, task]`, in tasks of different difficulty; some values are equal."""
    draws = np.random.default_rng(3)
    difficulty = draws.normal(0.0, 3.0, 40)
    first = difficulty + draws.normal(0.5, 1.0, (5, 40))
    return first.round(1), (difficulty + draws.normal(0.0, 1.0, (3, 40))).round(1)


def test_probability_of_improvement(scores: tuple[np.ndarray, np.ndarray]) -> None:
    ours = statistics.bootstrap(statistics.improvement, *scores).mean
    assert ours == pytest.approx(metrics.probability_of_improvement(*scores), rel=1e-12)
    assert 0.5 < ours < 1.0


def test_performance_profile(scores: tuple[np.ndarray, np.ndarray]) -> None:
    thresholds, (ours, _) = statistics.profiles(scores)
    theirs, _ = library.create_performance_profile({"first": scores[0]}, thresholds, reps=1)
    np.testing.assert_allclose(ours.mean, theirs["first"], rtol=1e-12)


@pytest.mark.filterwarnings("ignore:random_state is deprecated:FutureWarning")  # rliable's own
@pytest.mark.parametrize("axis", ["one seed", "one task"])
def test_intervals(scores: tuple[np.ndarray, np.ndarray], axis: str) -> None:
    values = scores[0][:1] if axis == "one seed" else scores[0].reshape(-1, 1)
    ours = statistics.bootstrap(statistics.mean, values)
    _, intervals = library.get_interval_estimates(
        {"first": values},
        lambda x: np.array([metrics.aggregate_mean(x)]),
        task_bootstrap=axis == "one seed",
        reps=RESAMPLES,
        random_state=np.random.RandomState(0),
    )
    low, high = intervals["first"][:, 0]
    np.testing.assert_allclose([ours.low, ours.high], [low, high], atol=TOLERANCE * (high - low))
