"""A recurrent value function: the expected return of the rest of a trial."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import Key
from maesn.learners.trial_value import AbstractTrialValue, elapsed_share
from maesn.learners.trials import Trials
from maesn.networks import RecurrentNetwork, init_recurrent_network
from maesn.numerics import MinibatchDescent
from maesn.policies import input_features, input_size
from maesn.settings import check_number, check_sizes


class RecurrentValue(AbstractTrialValue[RecurrentNetwork]):
    """V_t = mean + std * network(x_0 ... x_t), where x_t is what the policy sees, and the time.

    It shares no weights with the policy, whose step may be a natural gradient; so did the baseline
    of Duan et al. (2016, section 3). x_t is the policy's input and the elapsed share of the trial.
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
        check_sizes(self, "encoder_sizes", "readout_sizes")
        check_number("hidden_size", self.hidden_size, 1)

    def init_network(self, key: Key, observation_size: int, action_size: int) -> RecurrentNetwork:
        return init_recurrent_network(
            key,
            input_size(observation_size, action_size) + 1,
            1,
            encoder_sizes=self.encoder_sizes,
            hidden_size=self.hidden_size,
            readout_sizes=self.readout_sizes,
        )

    def outputs(self, network: RecurrentNetwork, trials: Trials) -> Float[Array, "trial time"]:
        def along(played: Trials) -> Float[Array, " time"]:
            inputs = jax.vmap(input_features, in_axes=(0, None))(played.inputs, jnp.zeros(0))
            features = jnp.concatenate([inputs, elapsed_share(played)[:, None]], axis=-1)
            return network.unroll(features, played.valid, network.initial_recurrent_state())[0][
                :, 0
            ]

        return jax.vmap(along)(trials)
