"""A ranking-weighted Gaussian process ensemble over training tasks.

Feurer, Letham and Bakshy 2018, "Scalable meta-learning for Bayesian optimization using
ranking-weighted Gaussian process ensembles" (arXiv 1802.02219). Each training task has a Gaussian
process of its own, and the new task one more. A model's weight is the share of joint posterior
samples in which it orders the new task's returns best, so tasks that do not help lose theirs.
"""

import warnings
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from botorch.fit import fit_gpytorch_mll
from botorch.models import SingleTaskGP
from botorch.models.transforms import Normalize
from botorch.settings import validate_input_scaling
from gpytorch.mlls import ExactMarginalLogLikelihood
from torch import Tensor
from torch.distributions import Normal

SAMPLES = 128
LATENTS = 100  # of the archive, that a training task's process is fitted to
OWN_FROM = 3  # readings from which on the new task has a process of its own
JITTER = 1e-4  # of standardised values


def standardized(values: Tensor) -> Tensor:
    """Return values of mean 0 and standard deviation 1 in each row; equal values become 0."""
    centred = values - values.mean(-1, keepdim=True)
    spread = centred.square().mean(-1, keepdim=True).sqrt()
    return centred / torch.where(spread > 0, spread, 1.0)


def fit(model: SingleTaskGP, start: SingleTaskGP | None = None) -> SingleTaskGP:
    """Put hyperparameters at their posterior mode, from those of another model on."""
    if start is not None:
        for own, other in zip(model.parameters(), start.parameters(), strict=True):
            own.data.copy_(other)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the optimiser, that it tries once more
        fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
    return model


def fitted(
    archive: Tensor, latents: Tensor, values: Tensor, start: SingleTaskGP | None = None
) -> SingleTaskGP:
    """Return a process of standardised values, `[n]`, at latents, `[n, z]`."""
    bounds = torch.stack([archive.amin(0), archive.amax(0)])
    scale = Normalize(archive.shape[1], bounds=bounds)
    with validate_input_scaling(False):  # equal returns have no spread
        model = SingleTaskGP(
            latents, values[:, None], outcome_transform=None, input_transform=scale
        )
    return fit(model, start)


def misranked(before: Tensor, returns: Tensor) -> Tensor:
    """Count the pairs that predictions, `[..., n, n]`, order otherwise than returns do, `[n]`.

    A prediction of a left-out reading is not compared with that reading: the diagonal is no pair.
    """
    pairs = ~torch.eye(len(returns), dtype=torch.bool)
    return ((before != (returns[:, None] < returns)) & pairs).sum((-1, -2))


def left_out(model: SingleTaskGP, y: Tensor) -> Tensor:
    """Draw each reading given the others, `[sample, n]`.

    Rasmussen and Williams 2006, equations 5.12.
    """
    model.train()  # so that it takes its own inputs
    prior = model.likelihood(model(*model.train_inputs))
    inverse = torch.linalg.inv(prior.covariance_matrix)
    mean = y - inverse @ (y - prior.mean) / inverse.diagonal()
    model.eval()
    return mean + inverse.diagonal().rsqrt() * torch.randn(SAMPLES, len(y), dtype=y.dtype)


class Predicted(NamedTuple):
    """What an ensemble expects."""

    mean: Tensor
    """`[point]`."""
    std: Tensor
    """`[point]`."""
    own: SingleTaskGP | None
    """The new task's process, if it has one."""


@dataclass(frozen=True)
class Ensemble:
    """The processes of the training tasks, at the archive.

    Attributes:
        archive: `[point, z]`.
        means: `[training task, point]`.
        covariances: `[training task, point, point]`, in single precision.
    """

    archive: Tensor
    means: Tensor
    covariances: Tensor

    @staticmethod
    def of(archive: Tensor, excess: Tensor) -> "Ensemble":
        """Fit a process to each training task's returns, `[task, point]`."""
        parts, model = [], None
        for values in standardized(excess[:, :LATENTS]):
            model = fitted(archive, archive[:LATENTS], values, model)
            with torch.no_grad():
                posterior = model.posterior(archive)
                parts.append((posterior.mean[:, 0], posterior.covariance_matrix.float()))
        return Ensemble(archive, *map(torch.stack, zip(*parts, strict=True)))

    def predicted(
        self, points: np.ndarray, returns: np.ndarray, before: Predicted | None = None
    ) -> Predicted:
        """Return what the ensemble expects in a new task.

        Args:
            points: indices of the latents that were played, `[reading]`.
            returns: what they returned, alike.
            before: what was expected a reading before, to begin the fit from.
        """
        torch.manual_seed(len(points))
        y, losses = standardized(torch.as_tensor(returns)), self._losses(points, returns)
        means, variances = self.means, self.covariances.diagonal(dim1=1, dim2=2).double()
        own = None
        if len(points) >= OWN_FROM:
            start = None if before is None else before.own
            own = model = fitted(self.archive, self.archive[points], y, start)
            with torch.no_grad():
                posterior = model.posterior(self.archive)
                lost = misranked(left_out(model, y)[..., :, None] < y, y)
            losses = torch.cat([losses, lost[:, None]], 1)
            means = torch.cat([means, posterior.mean.T])
            variances = torch.cat([variances, posterior.variance.T])
        is_best = (losses == losses.amin(1, keepdim=True)).double()
        weights = (is_best / is_best.sum(1, keepdim=True)).mean(0)  # models that tie share
        return Predicted(weights @ means, (weights**2 @ variances.clamp_min(0)).sqrt(), own)

    def _losses(self, points: np.ndarray, returns: np.ndarray) -> Tensor:
        """Count the pairs that each training task's process orders wrongly, `[sample, task]`."""
        count = len(points)
        if count < 2:
            return torch.zeros(SAMPLES, len(self.means))
        own = self.covariances[:, points][:, :, points].double()
        root = torch.linalg.cholesky(own + JITTER * torch.eye(count))
        noise = torch.randn(SAMPLES, len(self.means), count, 1, dtype=root.dtype)
        drawn = self.means[:, points] + (root @ noise)[..., 0]
        return misranked(drawn[..., :, None] < drawn[..., None, :], torch.as_tensor(returns))


def improvement(one: Predicted, played: np.ndarray) -> Tensor:
    """Return the expected improvement of each point over the best mean of the played, `[point]`."""
    mean, std, _ = one
    gain = mean - mean[played].amax()
    unit, scaled = Normal(0.0, 1.0), gain / std
    return std * unit.log_prob(scaled).exp() + gain * unit.cdf(scaled)
