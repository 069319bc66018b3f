"""A hypernetwork: a network makes the weights of another."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.networks.mlp import MLP
from maesn.numerics import multiply


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
