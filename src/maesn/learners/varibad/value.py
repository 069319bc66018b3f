"""The value of an observation, a belief, and a time."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import Key
from maesn.learners.trial_value import AbstractTrialValue, elapsed_share
from maesn.learners.trials import Trials
from maesn.networks import MLP, init_mlp
from maesn.numerics import MinibatchDescent
from maesn.settings import check_sizes


class BeliefValue(AbstractTrialValue[MLP]):
    """V_t = mean + std * network(what the policy sees, elapsed share of the trial).

    It needs no memory: the belief is one.
    """

    hidden_sizes: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers."""
    descent: MinibatchDescent = MinibatchDescent()
    """The optimiser of the fit."""

    def __check_init__(self) -> None:
        check_sizes(self, "hidden_sizes")

    def init_network(self, key: Key, observation_size: int, action_size: int) -> MLP:
        return init_mlp(key, (observation_size + 1, *self.hidden_sizes, 1))

    def outputs(self, network: MLP, trials: Trials) -> Float[Array, "trial time"]:
        seen = trials.inputs.observation
        share = jnp.broadcast_to(elapsed_share(trials)[:, None], (*seen.shape[:2], 1))
        features = jnp.concatenate([seen, share], axis=-1)
        flat = jax.vmap(network)(features.reshape(-1, features.shape[-1]))
        return flat.reshape(seen.shape[:2])
