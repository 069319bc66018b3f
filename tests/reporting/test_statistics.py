"""Intervals against closed forms, and their coverage against what theory predicts."""

import math
from typing import Any

import numpy as np
import pytest
import scipy.stats

from maesn.reporting.statistics import (
    NUM_RESAMPLES,
    bootstrap,
    curve,
    cvar,
    improvement,
    mean,
    score,
)

# Relative standard error of a standard deviation that is estimated from R normal draws.
RELATIVE_ERROR = 1.0 / math.sqrt(2 * NUM_RESAMPLES)
SIGMAS = 4.0
TOLERANCE = SIGMAS * RELATIVE_ERROR


def draw(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape)


def crossed_variance(values: np.ndarray) -> float:
    """Variance of the mean when rows and columns are resampled independently; closed form.

    Given row weights a, the mean over columns has variance Σ_t (y_t - ȳ)²/T², y = xᵀa/S; the
    multinomial a has E[a aᵀ] = I + (1 - 1/S) 1 1ᵀ.
    """
    num_rows, num_columns = values.shape
    between = values.mean(1).var() / num_rows
    centred = values - values.mean(1, keepdims=True)
    second_moment = np.eye(num_rows) + (1 - 1 / num_rows)
    within = np.trace(centred @ centred.T @ second_moment) / num_rows**2 / num_columns**2
    return float(between + within)


def difference(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A statistic of two samples."""
    return mean(x) - mean(y)


def test_one_seed_is_the_textbook_bootstrap_of_a_mean() -> None:
    values = draw(1, 100)
    interval = bootstrap(mean, values)
    assert interval.mean == pytest.approx(values.mean(), abs=1e-12)
    assert interval.standard_error == pytest.approx(values.std() / 10, rel=TOLERANCE)
    half = scipy.stats.norm.ppf(0.975) * values.std() / 10
    assert interval.low == pytest.approx(values.mean() - half, abs=0.1 * half)
    assert interval.high == pytest.approx(values.mean() + half, abs=0.1 * half)


@pytest.mark.parametrize(("num_seeds", "num_tasks"), [(4, 30), (3, 100), (6, 2), (5, 1)])
def test_seeds_and_tasks_are_resampled_as_crossed_factors(num_seeds: int, num_tasks: int) -> None:
    values = (
        draw(num_seeds, num_tasks) + 2 * draw(1, num_tasks, seed=1) + draw(num_seeds, 1, seed=2)
    )
    expected = math.sqrt(crossed_variance(values))
    # Few levels make the bootstrap distribution lumpy, which only helps: its tails are shorter.
    assert bootstrap(mean, values).standard_error == pytest.approx(expected, rel=TOLERANCE)


def test_two_seeds_are_too_few_to_be_resampled() -> None:
    values = draw(2, 30) + draw(2, 1, seed=2)
    expected = values.mean(axis=0).std() / math.sqrt(30)
    assert bootstrap(mean, values).standard_error == pytest.approx(expected, rel=TOLERANCE)
    assert not bootstrap(mean, draw(2, 1)).is_known


def test_identical_seeds_add_no_certainty_about_the_tasks() -> None:
    tasks = draw(1, 40)
    repeated = bootstrap(mean, np.repeat(tasks, 5, axis=0))
    assert repeated.standard_error == pytest.approx(tasks.std() / math.sqrt(40), rel=TOLERANCE)


def test_a_paired_difference_keeps_only_what_differs() -> None:
    hard, first, second = 10 * draw(1, 50), draw(1, 50, seed=1), draw(1, 50, seed=2)
    interval = bootstrap(difference, hard + first, hard + second)
    differences = first - second
    assert interval.mean == pytest.approx(differences.mean(), abs=1e-12)
    assert interval.standard_error == pytest.approx(
        differences.std() / math.sqrt(50), rel=TOLERANCE
    )


def test_the_seeds_of_a_difference_are_independent() -> None:
    """With one task, nothing but the seeds varies, and variances of the two means add."""
    first, second = draw(4, 1), 2 * draw(6, 1, seed=1)
    expected = math.sqrt(first.var() / 4 + second.var() / 6)
    interval = bootstrap(difference, first, second)
    assert interval.standard_error == pytest.approx(expected, rel=TOLERANCE)


def test_a_constant_difference_is_certain() -> None:
    values = draw(1, 20)
    interval = bootstrap(difference, values + 3.0, values)
    assert (interval.low, interval.high) == (pytest.approx(3.0), pytest.approx(3.0))


def test_coverage_is_what_theory_predicts() -> None:
    """For normal data the interval is mean ± 1.96 s √((n-1)/n)/√n, whose coverage is Student's."""
    num_tasks, repetitions = 30, 200
    values = draw(repetitions, 1, num_tasks, seed=3)
    hits = sum(i.low <= 0.0 <= i.high for i in (bootstrap(mean, one) for one in values))
    reach = scipy.stats.norm.ppf(0.975) * math.sqrt((num_tasks - 1) / num_tasks)
    expected = 1 - 2 * scipy.stats.t.sf(reach, num_tasks - 1)
    sigma = math.sqrt(expected * (1 - expected) / repetitions)
    assert abs(hits / repetitions - expected) < SIGMAS * sigma


def test_one_number_has_no_interval() -> None:
    interval = bootstrap(mean, np.array([[2.0]]))
    assert interval.mean == 2.0
    assert not interval.is_known


def test_curves_are_intervals_of_each_update() -> None:
    values = draw(3, 10, 4)
    assert curve(values).points == [bootstrap(mean, values[..., k]) for k in range(4)]


@pytest.mark.parametrize(
    ("statistic", "sizes"), [(difference, (10, 9)), (score, (9, 8, 9)), (improvement, (3, 4))]
)
def test_other_tasks_cannot_be_paired(statistic: Any, sizes: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=f"same tasks, got {' and '.join(map(str, sizes))}"):
        bootstrap(statistic, *(draw(1, size) for size in sizes))


def test_the_worst_tasks_are_those_of_each_seed() -> None:
    values = np.stack([np.arange(20.0), np.arange(20.0)[::-1]])
    assert cvar(values) == 0.5  # tasks 0 and 1 of one seed, 18 and 19 of the other
    assert cvar(values[:, :9]) == np.mean([0.0, 11.0])  # never less than one task
    spread = bootstrap(cvar, draw(1, 200))
    assert spread.low < spread.mean < scipy.stats.norm.ppf(0.1) < spread.high + 1


def test_the_probability_of_improvement_counts_pairs_of_seeds_within_tasks() -> None:
    first = np.array([[1.0, 5.0, 2.0], [3.0, 5.0, 0.0]])
    second = np.array([[2.0, 5.0, 1.0]])
    # Task 0: 1 < 2, 3 > 2; task 1: two ties; task 2: 2 > 1, 0 < 1.
    assert bootstrap(improvement, first, second).mean == pytest.approx((1 + 1 + 1) / 6)
    both = bootstrap(improvement, first, second).mean + bootstrap(improvement, second, first).mean
    assert both == pytest.approx(1.0)


def test_the_probability_of_improvement_of_one_seed_is_a_mean_of_coins() -> None:
    first, second = draw(1, 100), 0.5 + draw(1, 100, seed=1)
    coins = (first > second).astype(float)
    interval = bootstrap(improvement, first, second)
    assert interval.mean == pytest.approx(coins.mean())
    assert interval.standard_error == pytest.approx(coins.std() / 10, rel=TOLERANCE)


def test_the_score_of_the_baseline_is_0_and_of_the_oracle_1_whatever_is_drawn() -> None:
    tasks = 30.0 * draw(1, 40)
    idle, busy, oracle = tasks, tasks - 20.0, tasks + 100.0 + draw(1, 40, seed=1)
    for values, expected in ((idle, 0.0), (oracle, 1.0)):
        found = bootstrap(score, values, oracle, idle, busy)
        assert (found.mean, found.low, found.high) == pytest.approx((expected,) * 3, abs=1e-12)


def test_the_interval_of_a_score_is_that_of_a_ratio_of_means_over_the_same_tasks() -> None:
    num_tasks = 400
    baseline, oracle, values = (
        offset + spread * draw(1, num_tasks, seed=seed)
        for seed, (offset, spread) in enumerate(((-400.0, 10.0), (-300.0, 20.0), (-360.0, 15.0)))
    )
    found = bootstrap(score, values, oracle, baseline)
    gain, range_ = (values - baseline)[0], (oracle - baseline)[0]
    expected = gain.mean() / range_.mean()
    assert found.mean == pytest.approx(expected)
    # The delta method: a ratio of means is linear in them to first order.
    error = np.std(gain - expected * range_) / range_.mean() / np.sqrt(num_tasks)
    assert found.standard_error == pytest.approx(error, rel=TOLERANCE)
    assert found.high - found.low == pytest.approx(2 * 1.96 * error, rel=0.06)


def test_one_resample_of_a_score_takes_its_tasks_for_all_and_seeds_of_each() -> None:
    num_tasks, seeds = 12, {"values": 3, "first": 1, "second": 3, "oracle": 4}
    stream = np.random.default_rng(2)
    drawn = {
        name: stream.normal(size=(count, num_tasks)) + 2.0 * stream.normal(size=(count, 1))
        for name, count in seeds.items()
    }
    drawn["oracle"] += 20.0  # which of the two baselines is above differs between resamples
    found = bootstrap(score, *(drawn[name] for name in ("values", "oracle", "first", "second")))

    def expected(means: dict[str, float]) -> float:
        baseline = max(means["first"], means["second"])
        return (means["values"] - baseline) / (means["oracle"] - baseline)

    scores, highest = [], set()
    for _ in range(NUM_RESAMPLES):
        tasks = stream.integers(num_tasks, size=num_tasks)
        means = {
            name: float(x[stream.integers(len(x), size=len(x))][:, tasks].mean())
            for name, x in drawn.items()
        }
        scores.append(expected(means))
        highest.add(max(("first", "second"), key=means.__getitem__))
    assert highest == {"first", "second"}
    assert found.mean == pytest.approx(expected({name: x.mean() for name, x in drawn.items()}))
    # Two standard deviations from as many draws, each with its relative error.
    assert found.standard_error == pytest.approx(np.std(scores), rel=math.sqrt(2) * TOLERANCE)


def test_a_score_has_no_interval_if_the_oracle_may_be_no_better_than_the_baseline() -> None:
    found = bootstrap(score, draw(1, 8), np.eye(1, 8), np.zeros((1, 8)))
    assert found.mean == pytest.approx(8 * draw(1, 8).mean())
    assert not found.is_known
