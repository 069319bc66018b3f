"""The searches that `search_peers.py` compares, over the points of an archive."""

import warnings
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import cmaes
import numpy as np
import torch
from botorch.acquisition import LogExpectedImprovement
from botorch.fit import fit_gpytorch_mll
from botorch.models import SingleTaskGP
from botorch.models.transforms import Normalize, Standardize
from botorch_prior import ReturnGP
from gpytorch.mlls import ExactMarginalLogLikelihood
from search_peers_rgpe import Ensemble

from maesn.runtime import moments
from maesn.runtime.arrays import FloatArray
from maesn.runtime.return_model import Reading, ReturnModel
from maesn.runtime.search import LatentSearch, SearchSettings

FIRST_DRAWS = 3  # random points before a Gaussian process that knows nothing is fitted
SPREAD = 3.0  # of the archive's draws
# The archive is the whole choice, so that all compared searches have the same one.
SETTINGS = SearchSettings(draws=0)


@dataclass(frozen=True)
class Known:
    """What searches know before the first episode."""

    model: ReturnModel

    @cached_property
    def latents(self) -> torch.Tensor:
        """The archive, `[point, z]`."""
        return torch.as_tensor(self.model.archive)

    @cached_property
    def moments(self) -> Any:
        """Mean and covariance over the training tasks."""
        return moments(self.model, self.model.archive)

    @cached_property
    def ensemble(self) -> Ensemble:
        """A Gaussian process of each training task."""
        return Ensemble.of(self.latents, torch.as_tensor(self.model.prior.excess))


@dataclass
class Base:
    """What most searches share: a memory, and the best played point to deploy."""

    known: Known
    seed: int
    points: list[int] = field(default_factory=list)
    returns: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.generator = np.random.default_rng(self.seed)

    def told(self, point: int, episode_return: float, length: float) -> None:
        self.points.append(point)
        self.returns.append(episode_return)

    def best(self) -> int:
        """Return the point with the highest mean of its returns."""
        points, returns = np.asarray(self.points), np.asarray(self.returns)
        return max(self.points, key=lambda point: returns[points == point].mean())

    def fresh(self) -> int:
        """Return a random point that was not played."""
        left = np.setdiff1d(np.arange(len(self.known.latents)), self.points)
        return int(self.generator.choice(left))


class Ours(Base):
    """`--rule search draws=0`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.search = LatentSearch.start(self.known.model, SETTINGS)

    def propose(self) -> int:
        self.search, point = self.search.proposed(self.generator)
        return point

    def told(self, point: int, episode_return: float, length: float) -> None:
        self.search = self.search.after([Reading(point, episode_return, length)])

    def best(self) -> int:
        return self.search.best


class RandomLatents(Base):
    """Draws from the widened prior, one after the other."""

    def propose(self) -> int:
        return self.fresh()


class CmaEs(Base):
    """CMA-ES from N(0, 3^2 I); the archive's nearest latent stands for each of its draws."""

    def __post_init__(self) -> None:
        super().__post_init__()
        size = self.known.latents.shape[1]
        self.optimizer = cmaes.CMA(np.zeros(size), SPREAD, seed=self.seed + 1)
        self.round: list[tuple[FloatArray, float]] = []

    def propose(self) -> int:
        asked = self.optimizer.ask()
        return int(np.linalg.norm(self.known.latents.numpy() - asked, axis=1).argmin())

    def told(self, point: int, episode_return: float, length: float) -> None:
        super().told(point, episode_return, length)
        self.round.append((self.known.latents[point].numpy(), -episode_return))
        if len(self.round) == self.optimizer.population_size:
            self.optimizer.tell(self.round)
            self.round = []


def fitted(latents: torch.Tensor, points: list[int], returns: list[float]) -> SingleTaskGP:
    """Return BoTorch's default Gaussian process, its hyperparameters at their posterior mode."""
    y = torch.as_tensor(returns, dtype=torch.float64)[:, None]
    bounds = torch.stack([latents.min(0).values, latents.max(0).values])
    model = SingleTaskGP(
        latents[points],
        y,
        outcome_transform=Standardize(1),
        input_transform=Normalize(latents.shape[1], bounds=bounds),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the optimiser, that it tries once more
        fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
    return model


class BoTorchGP(Base):
    """BoTorch's default Gaussian process with log expected improvement."""

    def propose(self) -> int:
        # With equal returns alone, as far from the goal, there is nothing to fit.
        if len(self.points) < FIRST_DRAWS or np.ptp(self.returns) == 0:
            return self.fresh()
        model = fitted(self.known.latents, self.points, self.returns)
        return best_of(model, self.known.latents, self.known.latents[self.points])


def best_of(model: SingleTaskGP, candidates: torch.Tensor, played: torch.Tensor) -> int:
    """Return the candidate with the highest log expected improvement.

    Returns may be noisy, so the improvement is that over the best posterior mean of the played.
    """
    with torch.no_grad():
        improved = model.posterior(played).mean.max()
        return int(LogExpectedImprovement(model, improved)(candidates[:, None]).argmax())


class EmpiricalGP(Base):
    """One Gaussian process: mean and covariance over the training tasks, in BoTorch."""

    @property
    def indices(self) -> torch.Tensor:
        return torch.arange(len(self.known.latents), dtype=torch.float64)[:, None]

    def propose(self) -> int:
        if not self.points:
            return int(self.known.moments.mean.argmax())
        model = ReturnGP(self.known.moments, self.points, self.returns)
        return best_of(model, self.indices, self.indices[self.points])

    def best(self) -> int:
        with torch.no_grad():
            model = ReturnGP(self.known.moments, self.points, self.returns)
            return int(model.posterior(self.indices).mean.argmax())


class RankedEnsemble(Base):
    """RGPE (Feurer, Letham and Bakshy 2018) over the training tasks, expected improvement."""

    def propose(self) -> int:
        return self.known.ensemble.chosen(self.points, self.returns, self.seed)

    def best(self) -> int:
        return self.known.ensemble.deployed(self.points, self.returns, self.seed)


METHODS: dict[str, type[Base]] = {
    "search": Ours,
    "random latents": RandomLatents,
    "CMA-ES": CmaEs,
    "GP, log expected improvement": BoTorchGP,
    "ranking-weighted ensemble": RankedEnsemble,
    "empirical GP, log expected improvement": EmpiricalGP,
}
