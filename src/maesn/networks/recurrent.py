"""A recurrent network: encoder, gated recurrent units, and a readout whose weights may be made."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.axes import Key
from maesn.networks.gru import GRU, init_gru
from maesn.networks.mlp import MLP, Linear, init_mlp
from maesn.numerics import multiply

# Outputs start close to 0: "What matters in on-policy reinforcement learning?" (Andrychowicz et
# al. 2021, section 3.2) recommends last weights that are 100 times smaller.
OUTPUT_SCALE = 0.01


class HyperMLP(eqx.Module):
    """y = mlp_w(x), whose weights depend on a condition c:  w(c) = bias + Σ_k c_k slope_k.

    Source: Beck et al. 2022, "Hypernetworks in Meta-Reinforcement Learning", section 4,
    https://arxiv.org/abs/2210.11348. The map from c to weights is affine. It starts at their
    Bias-HyperInit: slopes are 0, and the bias is how an ordinary network starts. So all conditions
    share one network at first, and training learns what depends on c.
    """

    bias: MLP
    """The weights w where c = 0."""
    slope: MLP
    """Their change per component of c, `[condition, ...]`."""

    def __call__(
        self, x: Float[Array, " inputs"], condition: Float[Array, " condition"]
    ) -> Float[Array, " outputs"]:
        return self.weights(condition)(x)

    def weights(self, condition: Float[Array, " condition"]) -> MLP:
        """Return mlp_w."""

        def one(bias: Array, slope: Array) -> Array:
            change = multiply(condition, slope.reshape(condition.size, -1))
            return bias + change.reshape(bias.shape)

        return jax.tree.map(one, self.bias, self.slope)


def hyper_mlp(mlp: MLP, condition_size: int) -> HyperMLP:
    """Return a hypernetwork at Bias-HyperInit: it starts as `mlp`, whatever the condition."""
    slope = jax.tree.map(lambda x: jnp.zeros((condition_size, *x.shape)), mlp)
    return HyperMLP(mlp, slope)


class RecurrentNetwork(eqx.Module):
    """y = readout(e, h'), h' = gru(e, h), e = encoder(x).

    The readout sees the present input beside h': a reaction to it need not go through h'. It is a
    network of both side by side, or one of e whose weights h' makes.
    """

    encoder: tuple[Linear, ...]
    """Rectified linear layers; none for e = x."""
    gru: GRU
    readout: MLP | HyperMLP

    def initial_recurrent_state(self) -> Float[Array, " hidden"]:
        """Return h = 0."""
        return jnp.zeros(self.gru.hidden_size)

    def __call__(
        self, x: Float[Array, " inputs"], recurrent_state: Float[Array, " hidden"]
    ) -> tuple[Float[Array, " outputs"], Float[Array, " hidden"]]:
        """Return y and h' of one step."""
        encoded = self._encode(x)
        after = self.gru(encoded, recurrent_state)
        return self.readout(encoded, after), after

    def unroll(
        self,
        x: Float[Array, "time inputs"],
        valid: Bool[Array, " time"],
        recurrent_state: Float[Array, " hidden"],
    ) -> tuple[Float[Array, "time outputs"], Float[Array, " hidden"]]:
        """Return y of every step, and the last h'; where `valid` is false, h is kept."""
        encoded = jax.vmap(self._encode)(x)
        states, last = self.gru.unroll(encoded, valid, recurrent_state)
        return jax.vmap(self.readout)(encoded, states), last

    def _encode(self, x: Float[Array, " inputs"]) -> Float[Array, " encoded"]:
        for layer in self.encoder:
            x = jax.nn.relu(layer(x))
        return x


def init_recurrent_network(
    key: Key,
    inputs: int,
    outputs: int,
    *,
    encoder_sizes: tuple[int, ...],
    hidden_size: int,
    readout_sizes: tuple[int, ...],
    hyper: bool = False,
) -> RecurrentNetwork:
    """Return a network whose outputs are close to 0.

    With `hyper`, h' makes the weights of the readout, instead of being an input of it.
    """
    encoder_key, gru_key, readout_key = jax.random.split(key, 3)
    sizes = (inputs, *encoder_sizes)
    encoder = init_mlp(encoder_key, sizes).layers if encoder_sizes else ()
    beside = 0 if hyper else hidden_size
    readout = init_mlp(readout_key, (sizes[-1] + beside, *readout_sizes, outputs))
    readout = readout.scaled(-1, OUTPUT_SCALE)
    gru = init_gru(gru_key, sizes[-1], hidden_size)
    return RecurrentNetwork(encoder, gru, hyper_mlp(readout, hidden_size) if hyper else readout)
