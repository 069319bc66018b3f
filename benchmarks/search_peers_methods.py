"""The searches that `search_peers.py` compares, in all tasks at once, over an archive."""

from dataclasses import dataclass
from functools import cached_property

import cmaes
import numpy as np
import torch
from botorch.acquisition import LogExpectedImprovement
from botorch.models import SingleTaskGP
from botorch.models.transforms import Normalize, Standardize
from botorch.settings import validate_input_scaling
from botorch_prior import ReturnGP
from search_peers_play import Points
from search_peers_rgpe import Ensemble, fit, improvement
from torch import Tensor

from maesn.runtime import Moments, moments
from maesn.runtime.arrays import FloatArray
from maesn.runtime.posterior import Reading
from maesn.runtime.return_model import ReturnModel
from maesn.runtime.search import LatentSearch, SearchSettings

FIRST_DRAWS = 3  # random points before a Gaussian process that knows nothing is fitted
SPREAD = 3.0  # of the archive's draws
CHUNK = 50  # candidates at once; bounds the memory
# The archive is the whole choice, so that all compared searches have the same one.
SETTINGS = SearchSettings(draws=0)


@dataclass(frozen=True)
class Known:
    """What searches know before the first episode."""

    model: ReturnModel

    @property
    def archive(self) -> FloatArray:
        """`[point, z]`."""
        return self.model.archive

    @cached_property
    def moments(self) -> Moments:
        """Mean and covariance over the training tasks."""
        return moments(self.model, self.archive)

    @cached_property
    def ensemble(self) -> Ensemble:
        """A Gaussian process of each training task."""
        return Ensemble.of(*map(torch.as_tensor, (self.archive, self.model.prior.excess)))


class Base:
    """What most searches share: a memory, and the best played point to deploy."""

    def __init__(self, known: Known, num_tasks: int) -> None:
        self.known = known
        self.generators = [np.random.default_rng(task) for task in range(num_tasks)]
        self.points = np.zeros((num_tasks, 0), np.intp)
        self.returns = np.zeros((num_tasks, 0))

    def told(self, points: Points, returns: FloatArray, lengths: FloatArray) -> None:
        self.points = np.column_stack([self.points, points])
        self.returns = np.column_stack([self.returns, returns])

    def best(self) -> Points:
        """Return the point with the highest mean of its returns."""
        same = self.points[:, :, None] == self.points[:, None]
        means = np.where(same, self.returns[:, None], 0.0).sum(-1) / same.sum(-1)
        return self.points[np.arange(len(means)), means.argmax(axis=1)]

    def fresh(self) -> Points:
        """Return random points that were not played."""
        every = np.arange(len(self.known.archive))
        pairs = zip(self.generators, self.points, strict=True)
        return np.asarray([draw.choice(np.setdiff1d(every, points)) for draw, points in pairs])


class Ours(Base):
    """`--rule search draws=0`."""

    def __init__(self, known: Known, num_tasks: int) -> None:
        super().__init__(known, num_tasks)
        self.searches = [LatentSearch.start(known.model, SETTINGS)] * num_tasks

    def propose(self) -> Points:
        pairs = zip(self.searches, self.generators, strict=True)
        self.searches, points = zip(*(one.proposed(draw) for one, draw in pairs), strict=True)
        return np.asarray(points)

    def told(self, points: Points, returns: FloatArray, lengths: FloatArray) -> None:
        readings = map(Reading, points.tolist(), returns.tolist(), lengths.tolist())
        pairs = zip(self.searches, readings, strict=True)
        self.searches = [search.after([reading]) for search, reading in pairs]

    def best(self) -> Points:
        return np.asarray([search.best for search in self.searches])


class RandomLatents(Base):
    """Random latents of the archive, each of them once."""

    def propose(self) -> Points:
        return self.fresh()


class CmaEs(Base):
    """CMA-ES from N(0, 3^2 I); the archive's nearest latent stands for each of its draws."""

    def __init__(self, known: Known, num_tasks: int) -> None:
        super().__init__(known, num_tasks)
        start = np.zeros(known.archive.shape[1])
        self.optimizers = [cmaes.CMA(start, SPREAD, seed=task + 1) for task in range(num_tasks)]

    def propose(self) -> Points:
        asked = np.asarray([optimizer.ask() for optimizer in self.optimizers])
        distance = np.linalg.norm(asked[:, None] - self.known.archive, axis=-1)
        return np.asarray(distance.argmin(axis=1))

    def told(self, points: Points, returns: FloatArray, lengths: FloatArray) -> None:
        super().told(points, returns, lengths)
        size = self.optimizers[0].population_size
        if self.points.shape[1] % size == 0:
            for task, optimizer in enumerate(self.optimizers):
                latents = self.known.archive[self.points[task, -size:]]
                optimizer.tell(list(zip(latents, -self.returns[task, -size:], strict=True)))


def best_of(model: SingleTaskGP, candidates: Tensor, played: Tensor) -> Points:
    """Return the candidates with the highest log expected improvement, `[task]`.

    Returns may be noisy, so the improvement is that over the best posterior mean of the played.

    Args:
        model: one Gaussian process for each task.
        candidates: `[candidate, input]`.
        played: `[task, reading, input]`.
    """
    with torch.no_grad():
        improved = model.posterior(played).mean.amax(-2)  # `[task, 1]`
        improvement = LogExpectedImprovement(model, improved)
        parts = [
            improvement(part[:, None, None].expand(-1, len(played), 1, -1))
            for part in candidates.split(CHUNK)
        ]
    return np.asarray(torch.cat(parts).argmax(0))


class BoTorchGP(Base):
    """BoTorch's default Gaussian process with log expected improvement."""

    def __init__(self, known: Known, num_tasks: int) -> None:
        super().__init__(known, num_tasks)
        self.models: list[SingleTaskGP | None] = [None] * num_tasks

    def propose(self) -> Points:
        if self.points.shape[1] < FIRST_DRAWS:
            return self.fresh()
        latents = torch.as_tensor(self.known.archive)
        self.models = list(map(self.fitted, self.points, self.returns, self.models))
        pairs = zip(self.models, self.points, strict=True)
        return np.concatenate([best_of(one, latents, latents[own][None]) for one, own in pairs])

    def fitted(
        self, points: Points, returns: FloatArray, before: SingleTaskGP | None
    ) -> SingleTaskGP:
        """Return the model of one task."""
        latents = torch.as_tensor(self.known.archive)
        bounds = torch.stack([latents.amin(0), latents.amax(0)])
        with validate_input_scaling(False):  # equal returns have no spread
            model = SingleTaskGP(
                latents[points],
                torch.as_tensor(returns)[:, None],
                outcome_transform=Standardize(1),
                input_transform=Normalize(latents.shape[1], bounds=bounds),
            )
        return fit(model, before)


class EmpiricalGP(Base):
    """One Gaussian process: mean and covariance over the training tasks, in BoTorch."""

    def propose(self) -> Points:
        if not self.points.shape[1]:
            return np.full(len(self.points), self.known.moments.mean.argmax())
        points = torch.as_tensor(self.points)[..., None].double()
        return best_of(self.model(), self.indices, points)

    def best(self) -> Points:
        with torch.no_grad():
            every = self.indices.expand(len(self.points), -1, -1)
            return np.asarray(self.model().posterior(every).mean[..., 0].argmax(1))

    def model(self) -> ReturnGP:
        return ReturnGP(self.known.moments, self.points, self.returns)

    @property
    def indices(self) -> Tensor:
        """The inputs of all latents, `[point, 1]`."""
        return torch.arange(len(self.known.archive), dtype=torch.float64)[:, None]


class RankedEnsemble(Base):
    """RGPE (Feurer, Letham and Bakshy 2018) over the training tasks, expected improvement."""

    def __init__(self, known: Known, num_tasks: int) -> None:
        super().__init__(known, num_tasks)
        self.beliefs = [known.ensemble.predicted(self.points[0], self.returns[0])] * num_tasks

    def propose(self) -> Points:
        if not self.points.shape[1]:
            return self.best()
        pairs = zip(self.beliefs, self.points, strict=True)
        return np.asarray([int(improvement(one, played).argmax()) for one, played in pairs])

    def told(self, points: Points, returns: FloatArray, lengths: FloatArray) -> None:
        super().told(points, returns, lengths)
        predicted = self.known.ensemble.predicted
        self.beliefs = list(map(predicted, self.points, self.returns, self.beliefs))

    def best(self) -> Points:
        return np.asarray([int(one.mean.argmax()) for one in self.beliefs])


METHODS: dict[str, type[Base]] = {
    "search": Ours,
    "empirical GP, log expected improvement": EmpiricalGP,
    "random latents": RandomLatents,
    "CMA-ES": CmaEs,
    "GP, log expected improvement": BoTorchGP,
    "ranking-weighted ensemble": RankedEnsemble,
}
