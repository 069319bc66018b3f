"""A ranking-weighted Gaussian process ensemble over training tasks, for many new tasks at once.

Feurer, Letham and Bakshy 2018, "Scalable meta-learning for Bayesian optimization using
ranking-weighted Gaussian process ensembles" (arXiv 1802.02219). Each training task has a Gaussian
process of its own, and the new task one more. A model's weight is the share of joint posterior
samples in which it orders the new task's returns best, so tasks that do not help lose theirs.
"""

import warnings
from dataclasses import dataclass

import numpy as np
import torch
from botorch.fit import fit_gpytorch_mll
from botorch.models import SingleTaskGP
from botorch.models.transforms import Normalize
from gpytorch.mlls import ExactMarginalLogLikelihood
from torch import Tensor
from torch.distributions import Normal

SAMPLES = 128
LATENTS = 100  # of the archive, that a training task's process is fitted to
OWN_FROM = 3  # readings from which on the new task has a process of its own
CHUNK = 20  # training tasks at once; bounds the memory
JITTER = 1e-4  # of standardised values


def standardized(values: Tensor) -> Tensor:
    """Return values of mean 0 and standard deviation 1 in each row; equal values become 0."""
    centred = values - values.mean(-1, keepdim=True)
    spread = centred.square().mean(-1, keepdim=True).sqrt()
    return centred / torch.where(spread > 0, spread, 1.0)


def fit(model: SingleTaskGP) -> SingleTaskGP:
    """Put hyperparameters at their posterior mode; those of several tasks together."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the optimiser, that it tries once more
        fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
    return model


def fitted(archive: Tensor, latents: Tensor, values: Tensor) -> SingleTaskGP:
    """Return processes of standardised values, `[task, n]`, at latents, `[task, n, z]`."""
    bounds = torch.stack([archive.amin(0), archive.amax(0)])
    scale = Normalize(archive.shape[1], bounds=bounds)
    model = SingleTaskGP(latents, values[..., None], outcome_transform=None, input_transform=scale)
    return fit(model)


def misranked(before: Tensor, returns: Tensor) -> Tensor:
    """Count the pairs that predictions, `[..., n, n]`, order otherwise than returns do, `[n]`."""
    return (before != (returns[:, None] < returns)).sum((-1, -2))


def left_out(model: SingleTaskGP, y: Tensor) -> Tensor:
    """Draw each reading given the others, `[task, sample, n]`.

    Rasmussen and Williams 2006, equations 5.12.
    """
    model.train()  # so that it takes its own inputs
    prior = model.likelihood(model(*model.train_inputs))
    inverse = torch.linalg.inv(prior.covariance_matrix)
    precision = inverse.diagonal(dim1=-2, dim2=-1)
    mean = y - (inverse @ (y - prior.mean)[..., None])[..., 0] / precision
    model.eval()
    noise = torch.randn(len(y), SAMPLES, y.shape[1], dtype=y.dtype)
    return mean[:, None] + precision.rsqrt()[:, None] * noise


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
        parts, first = [], archive[:LATENTS]
        for values in standardized(excess[:, :LATENTS]).split(CHUNK):
            model = fitted(archive, first.expand(len(values), -1, -1), values)
            with torch.no_grad():
                posterior = model.posterior(archive.expand(len(values), -1, -1))
                parts.append((posterior.mean[..., 0], posterior.covariance_matrix.float()))
        return Ensemble(archive, *map(torch.cat, zip(*parts, strict=True)))

    def predicted(self, points: np.ndarray, returns: np.ndarray) -> tuple[Tensor, Tensor]:
        """Return mean and standard deviation of the ensemble, `[task, point]` each.

        Args:
            points: indices of the latents that were played, `[task, reading]`.
            returns: what they returned, alike.
        """
        torch.manual_seed(points.shape[1])
        y, own = standardized(torch.as_tensor(returns)), None
        if points.shape[1] >= OWN_FROM:
            model = fitted(self.archive, self.archive[points], y)
            with torch.no_grad():
                posterior = model.posterior(self.archive.expand(len(y), -1, -1))
                own = posterior.mean[..., 0], posterior.variance[..., 0], left_out(model, y)
        found = []
        for task, played in enumerate(points):
            means, variances = self.means, self.covariances.diagonal(dim1=1, dim2=2).double()
            losses = self._losses(played, y[task])
            if own is not None:
                mean, variance, drawn = (part[task] for part in own)
                lost = misranked(drawn[..., :, None] < y[task], y[task])
                losses = torch.cat([losses, lost[:, None]], 1)
                means = torch.cat([means, mean[None]])
                variances = torch.cat([variances, variance[None]])
            weights = _weights(losses)
            found.append((weights @ means, (weights**2 @ variances.clamp_min(0)).sqrt()))
        mean, std = map(torch.stack, zip(*found, strict=True))
        return mean, std

    def chosen(self, points: np.ndarray, returns: np.ndarray) -> Tensor:
        """Return the points with the largest expected improvement over the best that was played."""
        mean, std = self.predicted(points, returns)
        if not points.shape[1]:
            return mean.argmax(1)
        played = mean.gather(1, torch.as_tensor(points))
        unit, gain = Normal(0.0, 1.0), mean - played.amax(1, keepdim=True)
        scaled = gain / std
        return (std * unit.log_prob(scaled).exp() + gain * unit.cdf(scaled)).argmax(1)

    def _losses(self, played: np.ndarray, y: Tensor) -> Tensor:
        """Count the pairs that each training task's process orders wrongly, `[sample, task]`."""
        count = len(played)
        if count < 2:
            return torch.zeros(SAMPLES, len(self.means))
        own = self.covariances[:, played][:, :, played].double()
        root = torch.linalg.cholesky(own + JITTER * torch.eye(count))
        noise = torch.randn(SAMPLES, len(self.means), count, 1, dtype=y.dtype)
        drawn = self.means[:, played] + (root @ noise)[..., 0]
        return misranked(drawn[..., :, None] < drawn[..., None, :], y)


def _weights(losses: Tensor) -> Tensor:
    """Return how often each model loses least; equals share."""
    is_best = (losses == losses.amin(1, keepdim=True)).double()
    return (is_best / is_best.sum(1, keepdim=True)).mean(0)
