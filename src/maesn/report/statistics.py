"""How sure the reported means are: bootstrap intervals that say what they resample.

The tasks of a set are the same for every seed and every method, so seeds and tasks are crossed
factors. An interval draws tasks with replacement *once for all seeds and methods*, and seeds with
replacement independently of that (the "pigeonhole bootstrap"; Owen, "The pigeonhole bootstrap",
Annals of Applied Statistics 1(2), 2007). Drawing tasks afresh within every seed would treat an easy
task as several lucky ones and make the interval too narrow.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.stats
from jaxtyping import Float, Num

CONFIDENCE_LEVEL = 0.95
# The ends of a 95 % interval then move by 4 % of a standard error from one random seed to another.
NUM_RESAMPLES = 5000
_BATCH = 500  # resamples at a time; 5 seeds x 100 tasks then need 2 MB

SeedTaskValues = Float[np.ndarray, "seed task"]


@dataclass(frozen=True)
class Interval:
    """A mean and what a repetition of the experiment might have given instead."""

    mean: float
    low: float
    """Lower end; NaN if there is nothing to resample."""
    high: float
    standard_error: float
    label: str
    """What the interval is and what it resamples, to be printed beside it."""

    @property
    def is_known(self) -> bool:
        """Whether there was anything to resample."""
        return bool(np.isfinite(self.low))

    @property
    def excludes_zero(self) -> bool:
        """Whether the interval lies on one side of zero."""
        return self.low > 0 or self.high < 0


def mean_interval(values: SeedTaskValues, *, confidence: float = CONFIDENCE_LEVEL) -> Interval:
    """Return the mean over seeds and tasks with its percentile bootstrap interval.

        m* = 1/(S T) Σ_s Σ_t x[a_s, b_t],   a_s uniform on seeds, b_t uniform on tasks, iid

    with s in [1, S] and t in [1, T]; the interval lies between the quantiles of m*. A factor with
    one level is not resampled: with one seed the interval says nothing about other seeds. With
    fewer than five seeds it is narrower than it should be (a bootstrap of S values has (S - 1)/S
    of their variance). Values that are all equal give an interval of width 0.

    Args:
        values: x, one value per seed and task.
        confidence: probability that the interval covers the truth.
    """
    return _interval([_Term(1.0, values)], "", confidence)


def difference_interval(
    first: Float[np.ndarray, "first_seed first_task"],
    second: Float[np.ndarray, "second_seed second_task"],
    *,
    confidence: float = CONFIDENCE_LEVEL,
) -> Interval:
    """Return the mean of `first` minus `second` over the same tasks, with its interval.

    Paired: one resample takes the same tasks for both, so what makes a task easy for both cancels.
    The seeds of the two are unrelated and drawn independently.

    Args:
        first: one value per seed and task; the number of seeds may differ from that of `second`.
        second: the same tasks in the same order.
        confidence: probability that the interval covers the truth.

    Raises:
        ValueError: if the numbers of tasks differ.
    """
    if first.shape[1] != second.shape[1]:
        raise ValueError(
            f"`first` and `second` must hold the same tasks, got {first.shape[1]} and "
            f"{second.shape[1]}; compare results on one task set."
        )
    terms = [_Term(1.0, first), _Term(-1.0, second)]
    return _interval(terms, " of the paired difference", confidence)


def mean_intervals(values: Float[np.ndarray, "seed task update"]) -> list[Interval]:
    """Return one interval per update. All draw the same resamples, so that curves are smooth."""
    return [mean_interval(values[..., update]) for update in range(values.shape[-1])]


@dataclass(frozen=True)
class _Term:
    """One summand of the statistic: a sign and the values whose mean it multiplies."""

    sign: float
    values: SeedTaskValues

    @property
    def num_seeds(self) -> int:
        return self.values.shape[0]

    def mean(
        self, seeds: Num[np.ndarray, "*#resample _"], tasks: Num[np.ndarray, "*#resample _"]
    ) -> Float[np.ndarray, "..."]:
        """Return the signed mean over the drawn seeds and tasks, for each resample."""
        rows, columns = seeds.astype(int), tasks.astype(int)
        drawn = self.values[rows[..., :, None], columns[..., None, :]]
        return np.asarray(self.sign * drawn.mean((-2, -1)))


def _interval(terms: Sequence[_Term], what: str, confidence: float) -> Interval:
    """Bootstrap the sum of the terms; SciPy draws *indices*, which keeps the factors crossed."""
    sizes = [terms[0].values.shape[1], *(term.num_seeds for term in terms)]
    if min(sizes) < 1:
        raise ValueError(f"`values` must hold at least one seed and one task, got {sizes[::-1]}.")
    resampled = [factor for factor, size in enumerate(sizes) if size > 1]

    def statistic(*drawn: np.ndarray, axis: int) -> np.ndarray:
        indices = dict(zip(resampled, drawn, strict=True))
        tasks, *seeds = (indices.get(factor, np.zeros(1)) for factor in range(len(sizes)))
        means = [term.mean(rows, tasks) for term, rows in zip(terms, seeds, strict=True)]
        return np.asarray(sum(means))

    mean = float(sum(term.sign * term.values.mean() for term in terms))
    label = _label(sizes[0], sizes[1:], what, confidence)
    if not resampled:
        return Interval(mean, np.nan, np.nan, np.nan, label)
    result = scipy.stats.bootstrap(
        [np.arange(sizes[factor], dtype=float) for factor in resampled],
        statistic,
        n_resamples=NUM_RESAMPLES,
        batch=_BATCH,
        vectorized=True,
        confidence_level=confidence,
        method="percentile",
        rng=np.random.default_rng(0),  # the same numbers in every table and figure
    )
    ends = result.confidence_interval
    return Interval(mean, float(ends.low), float(ends.high), float(result.standard_error), label)


def _label(num_tasks: int, num_seeds: Sequence[int], what: str, confidence: float) -> str:
    """Say what is resampled, and what is not because there is only one of it."""
    each = " each" if len(num_seeds) > 1 else ""
    seeds = (
        _count(num_seeds[0], "seed") + each
        if len(set(num_seeds)) == 1
        else " against ".join(map(str, num_seeds)) + " seeds"
    )
    factors = {_count(num_tasks, "task"): num_tasks > 1, seeds: max(num_seeds) > 1}
    resampled = " and ".join(name for name, is_resampled in factors.items() if is_resampled)
    fixed = " and ".join(name for name, is_resampled in factors.items() if not is_resampled)
    if not resampled:
        return f"no interval{what}: {fixed}"
    level = f"{100 * confidence:g} % interval{what}, resampling {resampled}"
    return f"{level}; {fixed}" if fixed else level


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
