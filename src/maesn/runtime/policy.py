"""The feed-forward Gaussian policy, one observation at a time."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from maesn.runtime.arrays import FloatArray

Weights: TypeAlias = NDArray[np.float32]


@dataclass(frozen=True)
class GaussianPolicy:
    """pi(a | o, z) = N(mlp([o, z]), diag(std^2)), with rectified linear hidden layers.

    Source: appendix "Experimental Details". The weights have single precision, as in training.

    Attributes:
        weights: one matrix `[inputs, outputs]` per layer; the first layer's inputs are [o, z].
        biases: one vector `[outputs]` per layer.
        std: standard deviation of the actions, `[action]`.

    Raises:
        ValueError: a layer does not fit the one before it.
    """

    weights: tuple[Weights, ...]
    biases: tuple[Weights, ...]
    std: FloatArray

    def __post_init__(self) -> None:
        outputs = [bias.shape for bias in self.biases]
        following = [*(weight.shape[:1] for weight in self.weights[1:]), self.std.shape]
        fits = [weight.shape[1:] for weight in self.weights] == outputs == following
        if not fits or self.std.ndim != 1:
            shapes = [weight.shape for weight in self.weights]
            raise ValueError(
                f"`weights` {shapes}, `biases` {outputs} and `std` {self.std.shape} do not fit."
            )

    @property
    def input_size(self) -> int:
        """Number of components of an observation and a latent together."""
        return int(self.weights[0].shape[0])

    def given(self, latent: FloatArray) -> "ConditionedPolicy":
        """Return the policy conditioned on z = `latent`, for one episode.

        z is constant during an episode, so its part of the first layer is computed once:
        [o, z] W + b = o W_o + (z W_z + b).
        """
        split = self.input_size - latent.shape[0]
        first, bias = self.weights[0], self.biases[0]
        shifted = bias + latent.astype(np.float32) @ first[split:]
        return ConditionedPolicy(
            (np.ascontiguousarray(first[:split]), *self.weights[1:]), (shifted, *self.biases[1:])
        )


@dataclass(frozen=True)
class ConditionedPolicy:
    """The mean of the policy's action as a function of the observation alone, for one z."""

    weights: tuple[Weights, ...]
    biases: tuple[Weights, ...]

    def mean(self, observation: FloatArray) -> FloatArray:
        """Return the mean action in one state, `[action]`."""
        x = observation.astype(np.float32)
        last = len(self.weights) - 1
        for weight, bias in zip(self.weights[:last], self.biases[:last], strict=True):
            x = np.maximum(np.dot(x, weight) + bias, 0.0)
        return (np.dot(x, self.weights[last]) + self.biases[last]).astype(np.float64)
