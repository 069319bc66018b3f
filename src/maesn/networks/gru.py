"""Gated recurrent units (Cho et al. 2014), one layer."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.axes import Key
from maesn.networks.mlp import Linear
from maesn.numerics import multiply


class GRU(eqx.Module):
    """A recurrent layer that learns what to keep and what to forget.

        r  = σ(x W_r + b_r + h U_r)
        u  = σ(x W_u + b_u + h U_u)
        n  = tanh(x W_n + b_n + r (h U_n + c))
        h' = (1 - u) n + u h

    Source: Cho et al., "Learning phrase representations using RNN encoder-decoder for statistical
    machine translation" (2014), https://arxiv.org/abs/1406.1078, with the reset gate applied after
    the product, as in cuDNN and `equinox.nn.GRUCell`.
    """

    inputs: Linear
    """W and b of the gates r, u and n, side by side."""
    recurrent: Float[Array, "hidden gates"]
    """U of the gates r, u and n, side by side."""
    candidate_bias: Float[Array, " hidden"]
    """c."""

    @property
    def hidden_size(self) -> int:
        """Number of components of h."""
        return self.candidate_bias.shape[0]

    def __call__(
        self, x: Float[Array, " inputs"], hidden: Float[Array, " hidden"]
    ) -> Float[Array, " hidden"]:
        """Return h'."""
        reset_in, update_in, candidate_in = jnp.split(self.inputs(x), 3)
        reset_by, update_by, candidate_by = jnp.split(multiply(hidden, self.recurrent), 3)
        reset = jax.nn.sigmoid(reset_in + reset_by)
        update = jax.nn.sigmoid(update_in + update_by)
        candidate = jnp.tanh(candidate_in + reset * (candidate_by + self.candidate_bias))
        return (1.0 - update) * candidate + update * hidden

    def unroll(
        self,
        x: Float[Array, "time inputs"],
        valid: Bool[Array, " time"],
        hidden: Float[Array, " hidden"],
    ) -> tuple[Float[Array, "time hidden"], Float[Array, " hidden"]]:
        """Return h' of every step, and the last one; where `valid` is false, h does not change."""
        # x W belongs into the loop, and gates are computed again for the gradient: to write and
        # read those of all steps takes longer on a CPU.
        advance = jax.checkpoint(GRU.__call__, prevent_cse=False)

        def step(
            before: Float[Array, " hidden"], now: tuple[Array, Array]
        ) -> tuple[Float[Array, " hidden"], Float[Array, " hidden"]]:
            arriving, is_valid = now
            after = jnp.where(is_valid, advance(self, arriving, before), before)
            return after, after

        last, outputs = jax.lax.scan(step, hidden, (x, valid))
        return outputs, last


def init_gru(key: Key, inputs: int, hidden: int) -> GRU:
    """Return a GRU with Xavier-uniform W, orthogonal U, and zero biases."""
    input_key, recurrent_key = jax.random.split(key)
    # One draw per gate: side by side they would count as one larger matrix, and start smaller.
    xavier, orthogonal = jax.nn.initializers.glorot_uniform(), jax.nn.initializers.orthogonal()
    weight = [xavier(k, (inputs, hidden)) for k in jax.random.split(input_key, 3)]
    recurrent = [orthogonal(k, (hidden, hidden)) for k in jax.random.split(recurrent_key, 3)]
    return GRU(
        Linear(jnp.concatenate(weight, axis=1), jnp.zeros(3 * hidden)),
        jnp.concatenate(recurrent, axis=1),
        jnp.zeros(hidden),
    )
