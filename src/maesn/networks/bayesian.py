"""A neural network with a Gaussian over every weight, after VIME.

Source: Houthooft et al., "VIME: Variational Information Maximizing Exploration" (2016), section
2.5, https://arxiv.org/abs/1605.09674; Blundell et al., "Weight uncertainty in neural
networks" (2015), for the parameters; Kingma et al., "Variational dropout and the local
reparameterization trick" (2015), for the way it is sampled.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from maesn.axes import Key
from maesn.networks.mlp import MLP, Linear, init_mlp
from maesn.numerics import DiagonalGaussian


class BayesianNetwork(eqx.Module):
    """An MLP whose weights and biases w_i are independent Gaussians.

    q(w) = Π_i N(w_i | μ_i, σ_i²),   σ_i = softplus(ρ_i) = log(1 + exp(ρ_i))
    """

    mean: MLP
    """μ of every weight and bias."""
    rho: MLP
    """ρ of every weight and bias."""

    @property
    def input_size(self) -> int:
        """Number of components of an input."""
        return self.mean.layers[0].weight.shape[-2]

    @property
    def output_size(self) -> int:
        """Number of components of an output."""
        return self.mean.layers[-1].bias.shape[-1]

    @property
    def noise_size(self) -> int:
        """Number of components of the noise of one evaluation: one per unit."""
        return sum(layer.bias.shape[-1] for layer in self.mean.layers)

    @property
    def posterior(self) -> DiagonalGaussian:
        """q, over the vector of all weights."""
        log_std = jnp.log(jax.nn.softplus(ravel_pytree(self.rho)[0]))
        return DiagonalGaussian(ravel_pytree(self.mean)[0], log_std)

    def __call__(
        self, x: Float[Array, " inputs"], noise: Float[Array, " unit"]
    ) -> Float[Array, " outputs"]:
        """Evaluate the network once, drawing the units instead of the weights.

        Every unit h_j = Σ_i x_i w_ij + b_j is Gaussian given its inputs (local reparameterisation):

            h_j = m_j + s_j ε_j,   m_j = Σ_i x_i μ_ij + μ_bj,   s_j² = Σ_i x_i² σ_ij² + σ_bj²

        The noise is ε of all units, layer after layer.
        """
        *hidden, last = zip(self.mean.layers, self.rho.layers, strict=True)
        begin = 0
        for mean, rho in hidden:
            units = mean.bias.shape[0]
            x = jax.nn.relu(_units(x, mean, rho, noise[begin : begin + units]))
            begin += units
        return _units(x, *last, noise[begin:])

    def information_gain(
        self, gradient: "BayesianNetwork", step_size: float = 1.0
    ) -> Float[Array, ""]:
        """Divergence of q after one Newton step of size λ from q before it, to second order.

            KL( q(φ + λΔφ) || q(φ) ) ≈ ½ λ² ∇ℓᵀ H⁻¹ ∇ℓ,   Δφ = -H⁻¹ ∇ℓ

        H, the Hessian of that divergence at Δφ = 0, is diagonal:

            ∂²KL/∂μ² = 1/σ²,   ∂²KL/∂ρ² = 2 (dσ/dρ)² / σ²,   dσ/dρ = exp(ρ) / (1 + exp(ρ))

        Source: Houthooft et al. (2016), section 2.5, where ℓ is the negative log-likelihood of one
        transition, whose divergence term has no gradient at φ. The gradient ∇ℓ with respect to
        (μ, ρ) has the layout of the network.
        """
        mean_gradient, rho_gradient = ravel_pytree(gradient.mean)[0], ravel_pytree(gradient.rho)[0]
        rho = ravel_pytree(self.rho)[0]
        std, slope = jax.nn.softplus(rho), jax.nn.sigmoid(rho)
        by_mean = (std * mean_gradient) ** 2
        by_rho = 0.5 * (std / slope * rho_gradient) ** 2
        return 0.5 * step_size**2 * jnp.sum(by_mean + by_rho)


def init_bayesian_network(key: Key, sizes: tuple[int, ...], std: float) -> BayesianNetwork:
    """Return a network with Xavier-uniform means, and one standard deviation σ for all weights."""
    mean = init_mlp(key, sizes)
    rho = math.log(math.expm1(std))
    return BayesianNetwork(mean, jax.tree.map(lambda x: jnp.full_like(x, rho), mean))


def _units(
    x: Float[Array, " inputs"], mean: Linear, rho: Linear, noise: Float[Array, " outputs"]
) -> Float[Array, " outputs"]:
    variance = Linear(jax.nn.softplus(rho.weight) ** 2, jax.nn.softplus(rho.bias) ** 2)
    return mean(x) + jnp.sqrt(variance(x**2)) * noise
