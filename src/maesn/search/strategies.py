"""Strategies that search for a good latent by returns alone, without the training tasks' returns.

A strategy is for one task. It is immutable: `after` returns a new one.
"""

import copy
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from maesn.runtime.arrays import FloatArray

# Added to the standard deviation of the cross-entropy method's draws in every round. Without it the
# draws collapse to a point too early.
LEAST_STD = 0.05


class AbstractStrategy(ABC):
    """Chooses the latents that are played in one task."""

    @abstractmethod
    def proposed(self, generator: np.random.Generator) -> FloatArray:
        """Draw the latent to play next, `[z]`."""

    @abstractmethod
    def after(self, z: FloatArray, mean_return: float) -> "AbstractStrategy":
        """Return the strategy after one more latent was played."""

    @property
    @abstractmethod
    def deployed(self) -> FloatArray:
        """The latent to deploy, `[z]`."""


@dataclass(frozen=True)
class BestOf(AbstractStrategy):
    """Draws from N(0, spread^2 I); the best draw so far is deployed, and 0 before the first.

    Attributes:
        best: the draw with the highest return, `[z]`.
        spread: standard deviation of the draws.
        best_return: the return of `best`.
    """

    best: FloatArray
    spread: float
    best_return: float = -np.inf

    def proposed(self, generator: np.random.Generator) -> FloatArray:
        return self.spread * generator.standard_normal(len(self.best))

    def after(self, z: FloatArray, mean_return: float) -> "BestOf":
        is_better = mean_return > self.best_return
        return replace(self, best=z, best_return=mean_return) if is_better else self

    @property
    def deployed(self) -> FloatArray:
        return self.best


@dataclass(frozen=True)
class CrossEntropy(AbstractStrategy):
    """Draws from a Gaussian with independent components, fitted to the best draws of each round.

    Rubinstein 1999, "The cross-entropy method for combinatorial and continuous optimization". The
    mean is deployed.

    Attributes:
        mean: mean of the draws of this round, `[z]`.
        std: standard deviation of the draws of this round, `[z]`.
        round_size: draws per round.
        elite: share of a round that the next one is fitted to, at least two draws.
        played: latents of this round so far, with their returns.
    """

    mean: FloatArray
    std: FloatArray
    round_size: int
    elite: float
    played: tuple[tuple[FloatArray, float], ...] = ()

    def proposed(self, generator: np.random.Generator) -> FloatArray:
        return self.mean + self.std * generator.standard_normal(len(self.mean))

    def after(self, z: FloatArray, mean_return: float) -> "CrossEntropy":
        played = (*self.played, (z, mean_return))
        if len(played) < self.round_size:
            return replace(self, played=played)
        ranked = sorted(played, key=lambda one: -one[1])
        count = max(int(self.elite * self.round_size), 2)
        best = np.stack([latent for latent, _ in ranked[:count]])
        return replace(self, mean=best.mean(axis=0), std=best.std(axis=0) + LEAST_STD, played=())

    @property
    def deployed(self) -> FloatArray:
        return self.mean


@dataclass(frozen=True)
class CmaEs(AbstractStrategy):
    """The covariance matrix adaptation evolution strategy, by the library `cmaes`.

    Hansen 2016, "The CMA evolution strategy: a tutorial". The mean is deployed.

    Attributes:
        optimizer: `cmaes.CMA`, which minimises; it is copied before anything in it changes.
        played: latents of this generation so far, with their negated returns.
    """

    optimizer: Any
    played: tuple[tuple[FloatArray, float], ...] = ()

    def proposed(self, generator: np.random.Generator) -> FloatArray:
        optimizer = copy.deepcopy(self.optimizer)
        optimizer.reseed_rng(int(generator.integers(2**32)))
        return np.asarray(optimizer.ask(), np.float64)

    def after(self, z: FloatArray, mean_return: float) -> "CmaEs":
        played = (*self.played, (z, -mean_return))
        if len(played) < self.optimizer.population_size:
            return CmaEs(self.optimizer, played)
        optimizer = copy.deepcopy(self.optimizer)
        optimizer.tell(list(played))
        return CmaEs(optimizer)

    @property
    def deployed(self) -> FloatArray:
        return np.asarray(self.optimizer.mean, np.float64)
