"""A ranking-weighted Gaussian process ensemble over training tasks.

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
JITTER = 1e-4  # of standardised values


def standardized(values: Tensor) -> Tensor:
    """Return values of mean 0 and standard deviation 1 in each row; equal values become 0."""
    centred = values - values.mean(-1, keepdim=True)
    spread = centred.square().mean(-1, keepdim=True).sqrt()
    return centred / torch.where(spread > 0, spread, 1.0)


def fit(model: SingleTaskGP) -> SingleTaskGP:
    """Put hyperparameters at their posterior mode."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the optimiser, that it tries once more
        fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
    return model


def fitted(archive: Tensor, latents: Tensor, values: Tensor) -> SingleTaskGP:
    """Return a process of standardised values, `[n]`, at latents, `[n, z]`."""
    bounds = torch.stack([archive.amin(0), archive.amax(0)])
    scale = Normalize(archive.shape[1], bounds=bounds)
    model = SingleTaskGP(latents, values[:, None], outcome_transform=None, input_transform=scale)
    return fit(model)


def misranked(before: Tensor, returns: Tensor) -> Tensor:
    """Count the pairs that predictions, `[..., n, n]`, order otherwise than returns do, `[n]`."""
    return (before != (returns[:, None] < returns)).sum((-1, -2))


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
        parts = []
        for values in standardized(excess[:, :LATENTS]):
            model = fitted(archive, archive[:LATENTS], values)
            with torch.no_grad():
                posterior = model.posterior(archive)
                parts.append((posterior.mean[:, 0], posterior.covariance_matrix.float()))
        return Ensemble(archive, *map(torch.stack, zip(*parts, strict=True)))

    def predicted(self, points: np.ndarray, returns: np.ndarray) -> tuple[Tensor, Tensor]:
        """Return mean and standard deviation of the ensemble in a new task, `[point]` each.

        Args:
            points: indices of the latents that were played, `[reading]`.
            returns: what they returned, alike.
        """
        torch.manual_seed(len(points))
        y, losses = standardized(torch.as_tensor(returns)), self._losses(points, returns)
        means, variances = self.means, self.covariances.diagonal(dim1=1, dim2=2).double()
        if len(points) >= OWN_FROM:
            model = fitted(self.archive, self.archive[points], y)
            with torch.no_grad():
                posterior = model.posterior(self.archive)
                lost = misranked(left_out(model, y)[..., :, None] < y, y)
            losses = torch.cat([losses, lost[:, None]], 1)
            means = torch.cat([means, posterior.mean.T])
            variances = torch.cat([variances, posterior.variance.T])
        is_best = (losses == losses.amin(1, keepdim=True)).double()
        weights = (is_best / is_best.sum(1, keepdim=True)).mean(0)  # models that tie share
        return weights @ means, (weights**2 @ variances.clamp_min(0)).sqrt()

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


def improvement(mean: Tensor, std: Tensor, played: np.ndarray) -> Tensor:
    """Return the expected improvement of each point over the best mean of the played, `[point]`."""
    gain = mean - mean[played].amax()
    unit, scaled = Normal(0.0, 1.0), gain / std
    return std * unit.log_prob(scaled).exp() + gain * unit.cdf(scaled)
