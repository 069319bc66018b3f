"""A recurrent value function: the expected return of the rest of a trial."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.axes import Key
from maesn.learners.trials import Trials
from maesn.networks import RecurrentNetwork, check_sizes, init_recurrent_network
from maesn.numerics import MinibatchDescent, if_finite, mesh
from maesn.policies import input_features, input_size

# Our own value: weight of the past in the running mean and standard deviation of returns. They
# follow the policy within about ten iterations.
STATISTICS_DECAY = 0.9
SMALLEST_STD = 1e-4  # in the unit of returns, so that equal returns are not divided by 0


class ValueState(eqx.Module):
    """State of a `RecurrentValue`."""

    network: RecurrentNetwork
    opt_state: Any
    """State of Adam."""
    moments: Float[Array, " 3"]
    """Running sums of 1, return, and squared return, from which mean and deviation follow."""


class RecurrentValue(eqx.Module):
    """V_t = mean + std * network(x_0 ... x_t), fitted to λ-returns.

    It shares no weights with the policy, whose step may be a natural gradient; so did the baseline
    of Duan et al. (2016, section 3). x_t is the policy's input and the elapsed share of the trial.
    Running statistics standardise the returns, which makes learning rates independent of the unit
    of rewards (Yu et al. 2022, "The surprising effectiveness of PPO in cooperative multi-agent
    games", section 5.1).
    """

    encoder_sizes: tuple[int, ...] = ()
    """Widths of rectified linear layers before the recurrent layer."""
    hidden_size: int = 64
    """Components of the recurrent state."""
    readout_sizes: tuple[int, ...] = ()
    """Widths of the hidden layers after the recurrent layer."""
    descent: MinibatchDescent = MinibatchDescent()
    """The optimiser of the fit."""

    def __check_init__(self) -> None:
        check_sizes(self)

    def init(self, key: Key, observation_size: int, action_size: int) -> ValueState:
        """Return an untrained value function."""
        network = init_recurrent_network(
            key,
            input_size(observation_size, action_size) + 1,
            1,
            encoder_sizes=self.encoder_sizes,
            hidden_size=self.hidden_size,
            readout_sizes=self.readout_sizes,
        )
        return ValueState(network, self.descent.init(network), jnp.zeros(3))

    def values(self, state: ValueState, trials: Trials) -> Float[Array, "trial time"]:
        """Return V_t, in the unit of returns."""
        mean, std = _mean_and_std(state.moments)
        return mean + std * _outputs(state.network, trials)

    def fit(
        self, key: Key, state: ValueState, trials: Trials, returns: Float[Array, "trial time"]
    ) -> tuple[ValueState, Bool[Array, ""]]:
        """Return the value function fitted to returns, and whether the fit was accepted.

        If the result is not finite, the value function does not change.
        """
        moments = _moments_after(state.moments, trials, returns)
        mean, std = _mean_and_std(moments)

        def loss(
            network: RecurrentNetwork, batch: tuple[Trials, Array]
        ) -> tuple[Float[Array, ""], None]:
            sample, target = batch
            return mesh.part_of_mean((_outputs(network, sample) - target) ** 2, sample.valid), None

        network, opt_state, _ = self.descent.run(
            key, state.network, state.opt_state, loss, (trials, (returns - mean) / std)
        )
        return if_finite(ValueState(network, opt_state, moments), state)


def _outputs(network: RecurrentNetwork, trials: Trials) -> Float[Array, "trial time"]:
    steps = trials.valid.shape[1]
    share = jnp.arange(steps)[:, None] / steps

    def along(played: Trials) -> Float[Array, " time"]:
        inputs = jax.vmap(input_features, in_axes=(0, None))(played.inputs, jnp.zeros(0))
        features = jnp.concatenate([inputs, share], axis=-1)
        return network.unroll(features, played.valid, network.initial_recurrent_state())[0][:, 0]

    return jax.vmap(along)(trials)


def _moments_after(
    moments: Float[Array, " 3"], trials: Trials, returns: Float[Array, "trial time"]
) -> Float[Array, " 3"]:
    means = [mesh.mean_of_valid(power, trials.valid) for power in (returns, returns**2)]
    new = jnp.stack([jnp.ones(()), *means])
    return STATISTICS_DECAY * moments + (1.0 - STATISTICS_DECAY) * new


def _mean_and_std(moments: Float[Array, " 3"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return 0 and 1 before the first fit."""
    weight = jnp.where(moments[0] > 0, moments[0], 1.0)
    mean, square = moments[1] / weight, moments[2] / weight
    std = jnp.sqrt(jnp.maximum(square - mean**2, SMALLEST_STD**2))
    return mean, jnp.where(moments[0] > 0, std, 1.0)
