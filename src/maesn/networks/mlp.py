"""A multilayer perceptron whose leaves are arrays only."""

from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.axes import Key
from maesn.numerics import multiply


class Linear(eqx.Module):
    """An affine map x -> x W + b. The weight is stored as [input, output]."""

    weight: Float[Array, "*batch inputs outputs"]
    bias: Float[Array, "*batch outputs"]

    def __call__(self, x: Float[Array, " inputs"]) -> Float[Array, " outputs"]:
        return multiply(x, self.weight) + self.bias


class MLP(eqx.Module):
    """Rectified linear hidden layers and a linear output, of its inputs side by side.

    `equinox.nn.MLP` would do, but it carries its activation function as a leaf, and everything
    that travels through `jax.lax.scan` or is written to a checkpoint here holds arrays alone.
    """

    layers: tuple[Linear, ...]

    def __call__(self, *inputs: Float[Array, " _"]) -> Float[Array, " outputs"]:
        x = jnp.concatenate(inputs)
        for layer in self.layers[:-1]:
            x = jax.nn.relu(layer(x))
        return self.layers[-1](x)

    def scaled(self, layer: int, factor: float) -> "MLP":
        """Return the network with the weights of one layer, not its biases, times a factor."""
        return eqx.tree_at(
            lambda mlp: mlp.layers[layer].weight, self, replace_fn=lambda weight: factor * weight
        )


def init_mlp(key: Key, sizes: tuple[int, ...]) -> MLP:
    """Return an MLP with Xavier-uniform weights and zero biases, as in the reference."""
    keys = jax.random.split(key, len(sizes) - 1)
    xavier = jax.nn.initializers.glorot_uniform()
    layers = [
        Linear(xavier(layer_key, (inputs, outputs)), jnp.zeros(outputs))
        for layer_key, (inputs, outputs) in zip(keys, pairwise(sizes), strict=True)
    ]
    return MLP(tuple(layers))
