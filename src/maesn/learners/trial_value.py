"""A value function of trials, fitted by least squares to the returns of their rest."""

from abc import abstractmethod
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.axes import Key
from maesn.learners.trials import Trials
from maesn.numerics import MinibatchDescent, if_finite, masked_mean

Network = TypeVar("Network")

# Our own value: weight of the past in the running mean and standard deviation of returns. They
# follow the policy within about ten iterations.
STATISTICS_DECAY = 0.9
SMALLEST_STD = 1e-4  # in the unit of returns, so that equal returns are not divided by 0


class ValueState(eqx.Module):
    """State of an `AbstractTrialValue`."""

    network: Any
    opt_state: Any
    """State of Adam."""
    moments: Float[Array, " 3"]
    """Running sums of 1, return, and squared return, from which mean and deviation follow."""


class AbstractTrialValue(eqx.Module, Generic[Network]):
    """V_t = mean + std * network, fitted to λ-returns.

    Running statistics standardise the returns, which makes learning rates independent of the unit
    of rewards (Yu et al. 2022, "The surprising effectiveness of PPO in cooperative multi-agent
    games", section 5.1).
    """

    descent: eqx.AbstractVar[MinibatchDescent]

    @abstractmethod
    def init_network(self, key: Key, observation_size: int, action_size: int) -> Network:
        """Return freshly initialised weights."""

    @abstractmethod
    def outputs(self, network: Network, trials: Trials) -> Float[Array, "trial time"]:
        """Return the network's output before each step."""

    def init(self, key: Key, observation_size: int, action_size: int) -> ValueState:
        """Return an untrained value function."""
        network = self.init_network(key, observation_size, action_size)
        return ValueState(network, self.descent.init(network), jnp.zeros(3))

    def values(self, state: ValueState, trials: Trials) -> Float[Array, "trial time"]:
        """Return V_t, in the unit of returns."""
        mean, std = mean_and_std(state.moments)
        return mean + std * self.outputs(state.network, trials)

    def fit(
        self, key: Key, state: ValueState, trials: Trials, returns: Float[Array, "trial time"]
    ) -> tuple[ValueState, Bool[Array, ""]]:
        """Return the value function fitted to returns, and whether the fit was accepted.

        If the result is not finite, the value function does not change.
        """
        moments = moments_after(state.moments, returns, trials.valid)
        mean, std = mean_and_std(moments)

        def loss(network: Network, batch: tuple[Trials, Array]) -> tuple[Float[Array, ""], None]:
            sample, target = batch
            error = self.outputs(network, sample) - target
            return masked_mean(error**2, sample.valid), None

        network, opt_state, _ = self.descent.run(
            key, state.network, state.opt_state, loss, (trials, (returns - mean) / std)
        )
        return if_finite(ValueState(network, opt_state, moments), state)


def elapsed_share(trials: Trials) -> Float[Array, " time"]:
    """Return how much of a trial is over before each of its steps, from 0."""
    steps = trials.valid.shape[-1]
    return jnp.arange(steps) / steps


def explained_variance(
    advantages: Float[Array, "trial time"],
    expected: Float[Array, "trial time"],
    valid: Bool[Array, "trial time"],
) -> Float[Array, ""]:
    """Return the share of the variance of returns A + V that V explains; 0 if there is none."""
    spread = _variance(advantages + expected, valid)
    unknown = _variance(advantages, valid) / jnp.where(spread > 0, spread, 1.0)
    return jnp.where(spread > 0, 1.0 - unknown, 0.0)


def _variance(
    values: Float[Array, "trial time"], valid: Bool[Array, "trial time"]
) -> Float[Array, ""]:
    mean = masked_mean(values, valid)
    return masked_mean((values - mean) ** 2, valid)


def moments_after(
    moments: Float[Array, " 3"],
    values: Float[Array, "trial time"],
    valid: Bool[Array, "trial time"],
) -> Float[Array, " 3"]:
    """Return running moments after one more batch."""
    new = moments_of(values, valid)
    return STATISTICS_DECAY * moments + (1.0 - STATISTICS_DECAY) * new


def moments_of(
    values: Float[Array, "trial time"], valid: Bool[Array, "trial time"]
) -> Float[Array, " 3"]:
    """Return 1, mean and mean square of a batch: sums of them are moments of several batches."""
    means = [masked_mean(power, valid) for power in (values, values**2)]
    return jnp.stack([jnp.ones(()), *means])


def mean_and_std(moments: Float[Array, " 3"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return mean and standard deviation of running moments; 0 and 1 before the first batch."""
    weight = jnp.where(moments[0] > 0, moments[0], 1.0)
    mean, square = moments[1] / weight, moments[2] / weight
    std = jnp.sqrt(jnp.maximum(square - mean**2, SMALLEST_STD**2))
    return mean, jnp.where(moments[0] > 0, std, 1.0)
