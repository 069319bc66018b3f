"""Rules that search for a good latent by returns alone, for comparison with `SearchRule`."""

from collections.abc import Callable
from importlib import import_module
from typing import Any, ClassVar

import numpy as np

from maesn.envs import AnyEnv
from maesn.learners import AbstractFastLearner
from maesn.rules.base import AbstractRule, Budget, Trained
from maesn.runtime.arrays import FloatArray
from maesn.search import StrategyFastLearner, latent_of
from maesn.search.strategies import AbstractStrategy, BestOf, CmaEs, CrossEntropy
from maesn.settings import check_number, check_positive

_BUDGET = Budget(100, 1, 5)


class BestOfRule(AbstractRule):
    """Play latents drawn from the prior; deploy the one with the highest return so far.

    Every latent is played once, so the best of many may owe its rank to chance.
    """

    budget: ClassVar[Budget] = _BUDGET

    spread: float = 1.0
    """Standard deviation of the draws."""

    def __check_init__(self) -> None:
        check_positive(self, "spread")

    @property
    def label(self) -> str:
        return "best of draws"

    def fast_learner(self, trained: Trained, env: AnyEnv) -> AbstractFastLearner[Any]:
        return _strategy_learner(trained, lambda zero: BestOf(zero, self.spread))


class CrossEntropyRule(AbstractRule):
    """The cross-entropy method: draw latents in rounds, each around the best of the round before.

    Deploys the mean of the draws.
    """

    budget: ClassVar[Budget] = _BUDGET

    spread: float = 3.0
    """Standard deviation of the first draws: that of the archive of `search`."""
    round_size: int = 20
    """Draws per round."""
    elite: float = 0.2
    """Share of a round that the next one is fitted to, at least two draws."""

    def __check_init__(self) -> None:
        check_positive(self, "spread")
        check_number("round_size", self.round_size, 2)
        if not 0 < self.elite <= 1:
            raise ValueError(f"`elite` must be above 0 and at most 1, got {self.elite}.")

    @property
    def label(self) -> str:
        return "cross-entropy"

    def fast_learner(self, trained: Trained, env: AnyEnv) -> AbstractFastLearner[Any]:
        def start(zero: FloatArray) -> AbstractStrategy:
            std = np.full_like(zero, self.spread)
            return CrossEntropy(zero, std, self.round_size, self.elite)

        return _strategy_learner(trained, start)


class CmaEsRule(AbstractRule):
    """CMA-ES over latents, by the library `cmaes`, an extra: `pip install -e '.[cmaes]'`.

    Covariance matrix adaptation evolution strategy. Deploys the mean of the draws.
    """

    budget: ClassVar[Budget] = _BUDGET

    spread: float = 3.0
    """Standard deviation of the first draws: that of the archive of `search`."""
    population: int | None = None
    """Draws per generation; None: the library's default for the size of z, 6 for two components."""

    def __check_init__(self) -> None:
        check_positive(self, "spread")
        check_number("population", self.population, 4)

    @property
    def label(self) -> str:
        return "CMA-ES"

    def fast_learner(self, trained: Trained, env: AnyEnv) -> AbstractFastLearner[Any]:
        try:
            library = import_module("cmaes")
        except ImportError as error:
            raise ValueError(
                "the rule `cma_es` needs the library `cmaes`: pip install -e '.[cmaes]'."
            ) from error

        def start(zero: FloatArray) -> AbstractStrategy:
            # This seed has no effect: `CmaEs` seeds every draw.
            return CmaEs(library.CMA(zero, self.spread, seed=0, population_size=self.population))

        return _strategy_learner(trained, start)


def _strategy_learner(
    trained: Trained, start: Callable[[FloatArray], AbstractStrategy]
) -> AbstractFastLearner[Any]:
    """Return the learner whose strategy is `start(latent of zeros)`."""
    latent = latent_of(trained.fast_learner())
    return StrategyFastLearner(latent, start(np.zeros(latent.size)))
