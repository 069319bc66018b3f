"""How sure the reported means are: bootstrap intervals over tasks and seeds.

The tasks of a set are the same for every seed and every method, so seeds and tasks are crossed
factors. An interval draws tasks with replacement *once for all seeds and methods* and, where there
are three or more, seeds with replacement independently of that (the "pigeonhole bootstrap"; Owen,
"The pigeonhole bootstrap", Annals of Applied Statistics 1(2), 2007). Drawing tasks afresh within
every seed would treat an easy task as several lucky ones and make the interval too narrow.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

CONFIDENCE = 0.95
FEWEST_SEEDS = 3  # fewer do not tell how seeds differ
INTERVAL = f"{100 * CONFIDENCE:g} % bootstrap interval over tasks, and over seeds if three or more"
FEWEST_TASKS = 50  # fewer do not tell how the worst tenth of tasks fares
# The ends of a 95 % interval then move by 4 % of a standard error from one random seed to another.
NUM_RESAMPLES = 5000
_BATCH = 500  # resamples at a time; 5 seeds x 100 tasks then need 2 MB

Values = Float[np.ndarray, "*batch _ _"]
"""One value per seed and task. Samples that are compared may differ in their number of seeds."""

Statistic: TypeAlias = Callable[..., Float[np.ndarray, "*batch"]]
"""A number that describes samples, `Values` each; one number for each element of the batch."""


class Interval(NamedTuple):
    """A statistic, and what a repetition might have given instead: numbers, or arrays `[point]`."""

    mean: Any  # the statistic of the values themselves
    low: Any  # lower end; NaN if there is nothing to resample, or a resample has no such number
    high: Any
    standard_error: Any

    @property
    def is_known(self) -> bool:
        """Whether it has ends."""
        return bool(np.isfinite(self.low).all())

    @property
    def band(self) -> tuple[Any, Any, Any]:
        """A curve and the ends of its band."""
        return self[:3]

    @property
    def points(self) -> list["Interval"]:
        """The intervals of the points one by one."""
        return [Interval(*map(float, row)) for row in zip(*self, strict=True)]


def mean(x: Values) -> Float[np.ndarray, "*batch"]:
    """Return the mean over seeds and tasks."""
    return np.asarray(x.mean((-2, -1)))


def cvar(x: Values) -> Float[np.ndarray, "*batch"]:
    """Return the mean over each seed's worst tenth of tasks, its conditional value at risk.

    (Greenberg et al., "Train hard, fight easy: robust meta reinforcement learning", NeurIPS 2023)
    """
    worst = np.sort(x, axis=-1)[..., : max(x.shape[-1] // 10, 1)]
    return np.asarray(worst.mean((-2, -1)))


def improvement(x: Values, y: Values) -> Float[np.ndarray, "*batch"]:
    """Return the probability that x is better than y in a task. Larger values are better.

        P = 1/(S S' T) Σ_t Σ_s Σ_s' ( 1[x_st > y_s't] + 1/2 1[x_st = y_s't] )

    with s in [1, S], s' in [1, S'], t in [1, T] (Agarwal et al., "Deep reinforcement learning at
    the edge of the statistical precipice", NeurIPS 2021, "probability of improvement").
    """
    won = wins(x[..., :, None, :], y[..., None, :, :])
    return np.asarray(won.mean((-3, -2, -1)))


def wins(x: Float[np.ndarray, "*_"], y: Float[np.ndarray, "*_"]) -> Float[np.ndarray, "*_"]:
    """Return 1 where x is above y, 0 where it is below, and half a win for a tie."""
    return 0.5 + 0.5 * np.sign(x - y)


def score(x: Values, oracle: Values, *baselines: Values) -> Float[np.ndarray, "*batch"]:
    """Return the normalised score of x; NaN where the oracle is not above the baseline.

    score = (m(x) - b) / (m(oracle) - b),   b the largest m of the baselines, m the mean
    """
    baseline = np.max([mean(one) for one in baselines], axis=0)
    above = mean(oracle) - baseline
    return np.asarray((mean(x) - baseline) / np.where(above > 0, above, np.nan))


def bootstrap(statistic: Statistic, *samples: Float[np.ndarray, "*_"]) -> Interval:
    """Return a statistic of samples `[seed, task]` with its 95 % percentile bootstrap interval.

        m* = 1/(S T) Σ_s Σ_t x[a_s, b_t],   a_s uniform on seeds, b_t uniform on tasks, iid

    with s in [1, S] and t in [1, T], here of the mean; the interval lies between the quantiles of
    m*. Fewer than three seeds are not resampled: a_s = s, and the interval says nothing about other
    seeds. With fewer than five it is narrower than it should be (a bootstrap of S values has
    (S - 1)/S of their variance). Values that are all equal give an interval of width 0.

    Several samples are paired by tasks: one resample takes the same tasks for all, so what makes a
    task easy for all cancels. Their seeds are unrelated and drawn independently. Of two samples of
    the same trained policies, give their differences or `wins` as one sample. The points of samples
    `[point, seed, task]` all draw the same resamples, so that curves are smooth.

    Raises:
        ValueError: the numbers of tasks differ.
    """
    num_tasks = [sample.shape[-1] for sample in samples]
    if len(set(num_tasks)) > 1:
        raise ValueError(
            f"Samples that are compared must hold the same tasks, got "
            f"{' and '.join(map(str, num_tasks))}; compare results on one task set."
        )
    sizes = [num_tasks[0], *(sample.shape[-2] for sample in samples)]
    points = [np.ascontiguousarray(x).reshape(-1, *x.shape[-2:]) for x in samples]
    generator = np.random.default_rng(0)  # the same numbers in every table and figure
    resamples = np.full((len(points[0]), NUM_RESAMPLES), np.nan)
    some = sizes[0] > 1 or max(sizes) >= FEWEST_SEEDS
    for first in range(0, NUM_RESAMPLES if some else 0, _BATCH):
        tasks, *seeds = (generator.integers(size, size=(_BATCH, size)) for size in sizes)
        for few in (one for one in seeds if one.shape[1] < FEWEST_SEEDS):
            few[:] = np.arange(few.shape[1])
        # Places in the flattened values: much faster than two indices.
        chosen = [rows[:, :, None] * sizes[0] + tasks[:, None, :] for rows in seeds]
        for point, values in enumerate(zip(*points, strict=True)):
            drawn = map(np.take, values, chosen)
            resamples[point, first : first + _BATCH] = statistic(*drawn)
    tail = 50 * (1 - CONFIDENCE)
    low, high = np.percentile(resamples, (tail, 100 - tail), axis=-1)
    numbers = np.stack([statistic(*points), low, high, resamples.std(axis=-1, ddof=1)])
    return Interval(*numbers.reshape(4, *samples[0].shape[:-2]))


def curve(values: Float[np.ndarray, "seed task point"]) -> Interval:
    """Return the mean at each point with its interval."""
    return bootstrap(mean, np.moveaxis(values, -1, 0))


def profiles(
    samples: Sequence[Float[np.ndarray, "_ _"]],
) -> tuple[Float[np.ndarray, " threshold"], list[Interval]]:
    """Return thresholds from the least value to the largest, and the performance profiles there.

    The profile of a sample `[seed, task]` is the share of its values above each threshold:

        F(τ) = 1/(S T) Σ_s Σ_t 1[x_st > τ]

    (Agarwal et al. 2021, "performance profiles", run-score distributions).
    """
    ends = [end for sample in samples for end in (sample.min(), sample.max())]
    thresholds = np.linspace(min(ends), max(ends), 101)
    above = (sample[..., None] > thresholds for sample in samples)
    return thresholds, [curve(one.astype(float)) for one in above]
