"""Hypotheses about a new task, and the posterior over returns under all of them.

A new task may be *familiar*, like one of the training tasks; *shifted*, like one of them but with
another return c where the goal is never near; or *unlike* all of them. Each is a model of the
returns. Bayes' rule weighs them by what the episodes returned.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from maesn.runtime.arrays import FloatArray
from maesn.runtime.posterior import Posterior, Reading, normalized
from maesn.runtime.return_model import ReturnModel

# Components with a smaller share of the largest weight move no quantile that is shown.
_NEGLIGIBLE = 1e-6
_FAR = 8.0  # standard deviations from a mean, beyond which no quantile lies
_HALVINGS = 40  # of the range of quantiles, to 1e-12 of its width


@dataclass(frozen=True)
class MixedPosterior:
    """The posterior of f at some latents, under all hypotheses.

    A *component* is one Gaussian process: a training task under one hypothesis. They are counted
    hypothesis by hypothesis.

    Attributes:
        parts: the posterior under each hypothesis; they have the same points and readings. The
            first is that of a task like a training task.
        probabilities: probability of each hypothesis before the first episode.
    """

    parts: tuple[Posterior, ...]
    probabilities: tuple[float, ...]

    @staticmethod
    def of_prior(model: ReturnModel, familiar: float) -> "MixedPosterior":
        """Return the distribution at the archive before any reading.

        `familiar` is the probability of a task like a training task; the other two hypotheses share
        the rest. If it is certain, it stands alone.
        """
        models, probabilities = [model], [familiar]
        if familiar < 1.0:
            models += [model.shifted(), model.unlike()]
            probabilities += [(1.0 - familiar) / 2.0] * 2
        parts = tuple(Posterior.of_prior(one, model.archive) for one in models)
        return MixedPosterior(parts, tuple(probabilities))

    @property
    def points(self) -> FloatArray:
        """The latents, `[point, z]`."""
        return self.parts[0].points

    @property
    def readings(self) -> tuple[Reading, ...]:
        """The readings so far."""
        return self.parts[0].readings

    @cached_property
    def weights(self) -> FloatArray:
        """Posterior probability of each component, `[component]`."""
        pairs = zip(self.probabilities, self.parts, strict=True)
        logs = [np.log(one / part.model.num_tasks) + part.task_evidence for one, part in pairs]
        return normalized(np.concatenate(logs))

    @property
    def familiar(self) -> float:
        """Posterior probability that the task is like one of the training tasks."""
        return float(self.weights[: len(self.parts[0].task_mean)].sum())

    @cached_property
    def mean(self) -> FloatArray:
        """Mean of f, `[point]`."""
        return np.asarray(self.weights @ self._component_means)

    @cached_property
    def std(self) -> FloatArray:
        """Standard deviation of f, `[point]`."""
        between = self.weights @ (self._component_means - self.mean) ** 2
        within = [np.maximum(part.variance, 0.0) for part in self.parts]
        ends = np.cumsum([len(part.task_mean) for part in self.parts])[:-1]
        shares = np.array([one.sum() for one in np.split(self.weights, ends)])
        return np.sqrt(between + shares @ within)

    def part(self, component: int) -> tuple[Posterior, int]:
        """Return the posterior under a component's hypothesis, and the task within it."""
        for part in self.parts:
            if component < len(part.task_mean):
                break
            component -= len(part.task_mean)
        return part, component

    def predicted(
        self, point: int, length: float = 1.0
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return weights, means and standard deviations of an episode's return, `[component]`."""
        found = [part.predicted(point, length) for part in self.parts]
        stds = [np.full(len(one.mean), one.std) for one in found]
        return self.weights, np.concatenate([one.mean for one in found]), np.concatenate(stds)

    def place(self, reading: Reading) -> float:
        """Return the probability of a return below that of a reading."""
        weights, means, stds = self.predicted(reading.point, reading.length)
        return float(weights @ _below(reading.episode_return, means, stds))

    def quantiles(self, point: int, levels: Sequence[float]) -> tuple[float, ...]:
        """Return quantiles of the return of a whole episode with a latent, by bisection."""
        weights, means, stds = self.predicted(point)
        heavy = weights > _NEGLIGIBLE * weights.max()
        weights, means, stds = weights[heavy] / weights[heavy].sum(), means[heavy], stds[heavy]
        ends = float((means - _FAR * stds).min()), float((means + _FAR * stds).max())
        found = []
        for level in levels:
            low, high = ends
            for _ in range(_HALVINGS):
                middle = (low + high) / 2.0
                below = weights @ _below(middle, means, stds) < level
                low, high = (middle, high) if below else (low, middle)
            found.append((low + high) / 2.0)
        return tuple(found)

    def expected(self, point: int) -> Reading:
        """Return the reading that is expected of a whole episode with a latent."""
        weights, means, _ = self.predicted(point)
        return Reading(point, float(weights @ means))

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether a latent would return what it did before: no noise, `[point]`."""
        return self.parts[0].known

    def conditioned(self, reading: Reading) -> "MixedPosterior":
        """Return the posterior with one more reading."""
        return replace(self, parts=tuple(part.conditioned(reading) for part in self.parts))

    def extended(self, more: FloatArray) -> "MixedPosterior":
        """Return the posterior at its latents and at some more."""
        return replace(self, parts=tuple(part.extended(more) for part in self.parts))

    @property
    def _component_means(self) -> FloatArray:
        return np.concatenate([part.task_mean for part in self.parts])


def _below(value: float, means: FloatArray, stds: FloatArray) -> FloatArray:
    """Return the probability of less than a value in each component, a step where std is 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return normal_cdf(np.where(value == means, 0.0, (value - means) / stds))


def normal_cdf(standard: FloatArray) -> FloatArray:
    """Return the distribution function of N(0, 1), which NumPy lacks."""
    values = [math.erfc(-value / math.sqrt(2.0)) / 2.0 for value in standard.tolist()]
    return np.asarray(values, np.float64)
