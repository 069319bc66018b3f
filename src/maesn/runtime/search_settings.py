"""The settings of a search."""

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from maesn.runtime.return_model import ReturnModel, ReturnPrior

AcquisitionName: TypeAlias = Literal["ucb", "thompson"]


@dataclass(frozen=True)
class SearchSettings:
    """Settings of a search.

    Attributes:
        acquisition: both draw a hypothesis about the task by its posterior probability. Under it,
            `ucb` maximises the upper confidence bound, mean + exploration * std; `thompson` draws a
            training task by its posterior probability and takes that task's best latent.
        exploration: weight of the standard deviation in the upper confidence bound.
        draws: latents that are drawn around the best one in every round, once it has been played
            twice or its return is known exactly; 0 stays with the archive.
        draw_std: standard deviation of these draws, in units of z.
        residual: variance of a new task's returns that no training task explains, as a share of
            the mean variance over training tasks.
        length_scale: distance in z over which returns vary.
        jumps: whether the model allows for jumps of the return between near latents.
        familiar: probability, before the first episode, that a new task is like a training task. 1
            leaves out the other hypotheses.

    Raises:
        ValueError: a setting is out of its range.
    """

    acquisition: AcquisitionName = "ucb"
    exploration: float = 2.0
    draws: int = 8
    draw_std: float = 0.2
    residual: float = 0.1
    length_scale: float = 1.0
    jumps: bool = True
    familiar: float = 0.7

    def __post_init__(self) -> None:
        if self.acquisition not in get_args(AcquisitionName):
            names = ", ".join(get_args(AcquisitionName))
            raise ValueError(f"`acquisition` must be one of {names}, got {self.acquisition!r}.")
        for name in ("exploration", "draws", "residual"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"`{name}` must be at least 0, got {getattr(self, name)}.")
        if not 0 < self.familiar <= 1:
            raise ValueError(f"`familiar` must be above 0 and at most 1, got {self.familiar}.")
        for name in ("draw_std", "length_scale"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"`{name}` must be positive, got {getattr(self, name)}.")

    def model(self, prior: ReturnPrior) -> ReturnModel:
        """Return the model of returns with a prior."""
        return ReturnModel(prior, self.residual, self.length_scale, self.jumps)
