"""The prior of a search as a model of BoTorch: an empirical Gaussian process over latents.

    model = ReturnGP(moments(search.model, latents), points, returns)

Its inputs are indices of latents, so any set of latents can be searched. Lin et al. 2026,
"Empirical Gaussian processes" (arXiv 2602.12082), estimate mean and covariance from earlier tasks
in the same way; here both come from the training tasks of the policy.
"""

import torch
from botorch.models import SingleTaskGP
from gpytorch.kernels import Kernel
from gpytorch.means import Mean
from numpy.typing import ArrayLike
from torch import Tensor

from maesn.runtime import Moments

LEAST_NOISE = 1e-6  # as a share of the largest variance: exact returns must not be singular


class TableMean(Mean):
    """A mean that is read from a table."""

    def __init__(self, table: Tensor) -> None:
        super().__init__()
        self.table = table

    def forward(self, x: Tensor) -> Tensor:
        return self.table[x[..., 0].long()]


class TableKernel(Kernel):
    """A covariance that is read from a table."""

    def __init__(self, table: Tensor) -> None:
        super().__init__()
        self.table = table

    def forward(self, x1: Tensor, x2: Tensor, diag: bool = False, **_: object) -> Tensor:
        first, second = x1[..., 0].long(), x2[..., 0].long()
        if diag:
            return self.table[first, second]
        return self.table[first[..., :, None], second[..., None, :]]


class ReturnGP(SingleTaskGP):
    """Returns of latents, given some readings.

    Args:
        prior: of all latents that can be chosen, `[point]`.
        points: indices of the latents that were played, `[reading]`, or `[task, reading]` for
            several tasks at once; at least one.
        returns: what they returned, alike.
    """

    def __init__(self, prior: Moments, points: ArrayLike, returns: ArrayLike) -> None:
        covariance, played = torch.as_tensor(prior.covariance), torch.as_tensor(points)
        least = LEAST_NOISE * float(covariance.diagonal().max())
        noise = torch.as_tensor(prior.noise).clamp_min(least)
        super().__init__(
            played[..., None].double(),
            torch.as_tensor(returns)[..., None].double(),
            train_Yvar=noise[played][..., None],
            mean_module=TableMean(torch.as_tensor(prior.mean)),
            covar_module=TableKernel(covariance),
            outcome_transform=None,
        )
