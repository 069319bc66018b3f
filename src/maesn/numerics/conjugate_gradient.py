"""Conjugate gradients with a fixed number of steps, for products that are costly to trace."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.numerics.products import multiply


class _Iterate(eqx.Module):
    """State of the iteration: x_k, r_k = b - A x_k, p_k and r_k·r_k."""

    solution: Float[Array, "parameter"]
    residual: Float[Array, "parameter"]
    direction: Float[Array, "parameter"]
    squared_norm: Float[Array, ""]


def conjugate_gradient(
    product: Callable[[Float[Array, "parameter"]], Float[Array, "parameter"]],
    target: Float[Array, "parameter"],
    num_steps: int,
    residual_tolerance: float = 1e-10,
) -> tuple[Float[Array, "parameter"], Float[Array, ""]]:
    """Solve A x = b for a symmetric positive (semi)definite A known by its products.

    From x_0 = 0, r_0 = p_0 = b, for k in [0, num_steps-1],

        α_k = r_k·r_k / p_k·A p_k
        x_{k+1} = x_k + α_k p_k
        r_{k+1} = r_k - α_k A p_k
        p_{k+1} = r_{k+1} + (r_{k+1}·r_{k+1} / r_k·r_k) p_k.

    Steps change nothing once r_k·r_k <= `residual_tolerance` (so an exactly solved system stays
    finite) or p_k·A p_k <= 0 (rounding has used up the curvature). A product that is not finite
    makes the solution not finite: the caller sees it. `product` is traced once.

    Source: Hestenes and Stiefel, "Methods of conjugate gradients for solving linear systems"
    (1952), equations 3:1.

    Args:
        product: v ↦ A v.
        target: b.
        num_steps: the number of steps, and of products.
        residual_tolerance: bound on the *squared* norm r·r. The default, like this meaning, is
            the one of the reference implementation's trust region step.

    Returns:
        x, and the norm ‖b - A x‖₂ of its residual, as updated by the recursion.
    """

    def step(iterate: _Iterate, _: None) -> tuple[_Iterate, None]:
        image = product(iterate.direction)  # A p_k
        curvature = multiply(iterate.direction, image)
        # Negated comparisons, because NaN must count as unfinished and reach the solution.
        active = ~(iterate.squared_norm <= residual_tolerance) & ~(curvature <= 0.0)
        length = _guarded_ratio(active, iterate.squared_norm, curvature)
        solution = iterate.solution + length * iterate.direction
        residual = iterate.residual - length * image
        squared_norm = multiply(residual, residual)
        ratio = _guarded_ratio(active, squared_norm, iterate.squared_norm)
        direction = residual + ratio * iterate.direction
        following = _Iterate(solution, residual, direction, squared_norm)
        return jax.tree.map(lambda new, old: jnp.where(active, new, old), following, iterate), None

    start = _Iterate(jnp.zeros_like(target), target, target, multiply(target, target))
    last, _ = jax.lax.scan(step, start, None, length=num_steps)
    return last.solution, jnp.sqrt(last.squared_norm)


def _guarded_ratio(
    active: Bool[Array, ""], numerator: Float[Array, ""], denominator: Float[Array, ""]
) -> Float[Array, ""]:
    """The quotient where `active`, else 0 without ever dividing by zero."""
    return jnp.where(active, numerator, 0.0) / jnp.where(active, denominator, 1.0)
