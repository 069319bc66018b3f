"""A ranking-weighted Gaussian process ensemble over training tasks.

Feurer, Letham and Bakshy 2018, "Scalable meta-learning for Bayesian optimization using
ranking-weighted Gaussian process ensembles" (arXiv 1802.02219). Each training task has a Gaussian
process of its own, and the new task one more. A model's weight is the share of joint posterior
samples in which it orders the new task's returns best, so tasks that do not help lose theirs.
"""

from dataclasses import dataclass

import torch
from botorch.fit import fit_gpytorch_mll
from botorch.models import SingleTaskGP
from botorch.models.transforms import Normalize
from gpytorch.mlls import ExactMarginalLogLikelihood
from torch import Tensor
from torch.distributions import Normal

SAMPLES = 256
LATENTS = 100  # of the archive, that a task's process is fitted to
OWN_FROM = 3  # readings from which on the new task has a process of its own


def standardized(values: Tensor) -> Tensor:
    """Return values of mean 0 and standard deviation 1 in each row; equal values become 0."""
    centred = values - values.mean(-1, keepdim=True)
    return centred / centred.std(-1, keepdim=True).clamp_min(1e-9)


def fitted(latents: Tensor, bounds: Tensor, values: Tensor) -> SingleTaskGP:
    """Return a process of standardised values, `[n]`, at latents, `[n, z]`."""
    transform = Normalize(latents.shape[1], bounds=bounds)
    model = SingleTaskGP(
        latents, values[:, None], outcome_transform=None, input_transform=transform
    )
    fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
    return model


def misranked(predicted: Tensor, returns: Tensor) -> Tensor:
    """Count the pairs that predictions, `[..., n]`, order otherwise than returns do, `[n]`."""
    before = predicted[..., :, None] < predicted[..., None, :]
    return (before != (returns[:, None] < returns)).sum((-1, -2))


def left_out(model: SingleTaskGP, returns: Tensor) -> Tensor:
    """Count misranked pairs of samples of each reading given the others, `[sample]`.

    Moments by Rasmussen and Williams 2006, equations 5.12; each sample is compared with the returns
    of the other readings.
    """
    model.train()
    prior = model.likelihood(model(*model.train_inputs))
    inverse = torch.linalg.inv(prior.covariance_matrix)
    centred = model.train_targets - prior.mean
    mean = model.train_targets - (inverse @ centred) / inverse.diagonal()
    drawn = mean + inverse.diagonal().rsqrt() * torch.randn(SAMPLES, len(mean), dtype=mean.dtype)
    model.eval()
    before = drawn[:, :, None] < model.train_targets
    return (before != (returns[:, None] < returns)).sum((-1, -2))


@dataclass(frozen=True)
class Ensemble:
    """The processes of the training tasks, at the archive.

    Attributes:
        latents: the archive, `[point, z]`.
        means: `[task, point]`.
        covariances: `[task, point, point]`.
    """

    latents: Tensor
    means: Tensor
    covariances: Tensor

    @staticmethod
    def of(latents: Tensor, excess: Tensor) -> "Ensemble":
        """Fit a process to each training task's returns, `[task, point]`."""
        bounds, found = torch.stack([latents.min(0).values, latents.max(0).values]), []
        for values in standardized(excess[:, :LATENTS]):
            model = fitted(latents[:LATENTS], bounds, values)
            with torch.no_grad():
                posterior = model.posterior(latents)
                found.append((posterior.mean[:, 0], posterior.covariance_matrix.float()))
        return Ensemble(latents, *(torch.stack(part) for part in zip(*found, strict=True)))

    def predicted(
        self, points: list[int], returns: list[float], seed: int
    ) -> tuple[Tensor, Tensor]:
        """Return mean and standard deviation of the ensemble at the archive, `[point]` each."""
        torch.manual_seed(seed)
        y = standardized(torch.as_tensor(returns, dtype=torch.float64))
        means, variances = self.means, self.covariances.diagonal(dim1=-2, dim2=-1).double()
        losses = torch.zeros(SAMPLES, len(means), dtype=torch.long)
        if points:
            own = self.covariances[:, points][:, :, points].double()
            root = torch.linalg.cholesky(own + 1e-4 * torch.eye(len(points)))
            noise = torch.randn(SAMPLES, len(means), len(points), 1, dtype=torch.float64)
            losses = misranked(means[:, points] + (root @ noise)[..., 0], y)
        if len(points) >= OWN_FROM and y.any():
            bounds = torch.stack([self.latents.min(0).values, self.latents.max(0).values])
            model = fitted(self.latents[points], bounds, y)
            with torch.no_grad():
                posterior = model.posterior(self.latents)
                losses = torch.cat([losses, left_out(model, y)[:, None]], 1)
            means = torch.cat([means, posterior.mean.T])
            variances = torch.cat([variances, posterior.variance.T])
        is_best = (losses == losses.min(1, keepdim=True).values).double()
        weights = (is_best / is_best.sum(1, keepdim=True)).mean(0)
        return weights @ means, (weights**2 @ variances.clamp_min(0)).sqrt()

    def chosen(self, points: list[int], returns: list[float], seed: int) -> int:
        """Return the point with the largest expected improvement over the best that was played."""
        mean, std = self.predicted(points, returns, seed)
        if not points:
            return int(mean.argmax())
        unit, gain = Normal(0.0, 1.0), mean - mean[points].max()
        scaled = gain / std
        return int((std * unit.log_prob(scaled).exp() + gain * unit.cdf(scaled)).argmax())

    def deployed(self, points: list[int], returns: list[float], seed: int) -> int:
        """Return the point with the highest mean."""
        return int(self.predicted(points, returns, seed)[0].argmax())
