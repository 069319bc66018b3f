"""TRPO's step on any pytree of parameters (Schulman et al. 2015, appendix C)."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from maesn.numerics import AbstractDistribution, conjugate_gradient, multiply
from maesn.numerics.mesh import total
from maesn.settings import check_least, check_positive

Parameters = TypeVar("Parameters")
Vector = Float[Array, " parameter"]

# Keeps the step finite where the curvature vanishes; from the reference.
CURVATURE_EPSILON = 1e-8


class Candidate(NamedTuple):
    """Loss and KL of candidate parameters."""

    loss: Float[Array, "*task"]
    kl: Float[Array, "*task"]
    """Mean KL(old || candidate) of the action distributions."""


class TrustRegionInfo(eqx.Module):
    """Info of one step."""

    accepted: Bool[Array, ""]
    """False if no candidate improved the loss within the trust region: nothing has changed."""
    backtracks: Int[Array, ""]
    loss_before: Float[Array, ""]
    loss_after: Float[Array, ""]
    kl: Float[Array, ""]
    gradient_norm: Float[Array, ""]
    residual_norm: Float[Array, ""]
    """Norm of the residual that the conjugate gradient method stopped at."""


class TrustRegion(eqx.Module):
    """Natural gradient step with a bound on the mean KL, and a backtracking line search.

    The direction d solves H d = -g with H = J'FJ + damping I, where J is the Jacobian of the action
    distributions with respect to the parameters and F their Fisher information. The first candidate
    is the step sqrt(2 max_kl / d'Hd) d. It is shortened until the loss is lower than before and the
    KL is below max_kl.
    """

    max_kl: float = 0.01
    """Bound on the mean KL divergence of one step. Reference: 0.01."""
    cg_steps: int = 20
    """Number of steps of the conjugate gradient method. Reference: 10, with curvature by finite
    differences. `results/curvature` compares runs with 10 and with 20."""
    damping: float = 1e-5
    """Number that is added to the diagonal of the curvature. Reference: 1e-5."""
    backtrack_ratio: float = 0.8
    """Factor from one candidate's length to the next in the line search. Reference: 0.8."""
    max_backtracks: int = 15
    """Number of candidates in the line search, the first one included. Reference: 15."""

    def __check_init__(self) -> None:
        check_positive(self, "max_kl")
        check_least(self, cg_steps=1, max_backtracks=1, damping=0)
        if not 0 < self.backtrack_ratio < 1:
            raise ValueError(f"`backtrack_ratio` must lie in (0, 1), got {self.backtrack_ratio}.")

    def step(
        self,
        parameters: Parameters,
        evaluate: Callable[[Parameters], Candidate],
        loss_and_gradient: Callable[[Parameters], tuple[Float[Array, ""], Parameters]],
        distribution: Callable[[Parameters], AbstractDistribution],
        weight: Float[Array, "*batch"],
    ) -> tuple[Parameters, TrustRegionInfo]:
        """Return improved parameters, or the same ones if no candidate is acceptable.

        Args:
            parameters: the parameters before the step.
            evaluate: returns the loss, and the mean KL from the distributions at `parameters`. It
                is not differentiated. Where the KL exceeds `max_kl`, the loss may be anything, and
                the KL any number above it.
            loss_and_gradient: returns the same loss, and its gradient.
            distribution: returns the action distributions `[*batch, action]`, for the curvature.
            weight: weight of each of them in the mean KL; they sum to 1 where all tasks have steps.
                Where devices share the tasks (`maesn.numerics.mesh`), `distribution` and `weight`
                are a device's own part, and the losses are those of all tasks.
        """
        flat, unravel = ravel_pytree(parameters)
        loss_before, gradient_tree = loss_and_gradient(parameters)
        gradient, _ = ravel_pytree(gradient_tree)
        product = self._curvature_product(lambda x: distribution(unravel(x)), flat, weight)
        direction, residual_norm = conjugate_gradient(product, -gradient, self.cg_steps)
        curvature = multiply(direction, product(direction))
        longest = jnp.sqrt(2 * self.max_kl / (curvature + CURVATURE_EPSILON)) * direction
        search = self._line_search(lambda x: evaluate(unravel(x)), flat, longest, loss_before)
        backtracks = search.tried - 1
        info = TrustRegionInfo(
            accepted=search.accepted,
            backtracks=backtracks,
            loss_before=loss_before,
            loss_after=jnp.where(search.accepted, search.last.loss, loss_before),
            kl=jnp.where(search.accepted, search.last.kl, 0.0),
            gradient_norm=jnp.linalg.norm(gradient),
            residual_norm=residual_norm,
        )
        moved = flat + self._length(backtracks) * longest
        return unravel(jnp.where(search.accepted, moved, flat)), info

    def _curvature_product(
        self,
        distribution: Callable[[Vector], AbstractDistribution],
        flat: Vector,
        weight: Float[Array, "*batch"],
    ) -> Callable[[Vector], Vector]:
        """Return v -> (J'FJ + damping I) v: linearised once, positive semidefinite."""
        present, jacobian = jax.linearize(distribution, flat)
        transposed = jax.linear_transpose(jacobian, flat)

        def product(vector: Vector) -> Vector:
            image = present.fisher_product(jacobian(vector))
            weighted = jax.tree.map(lambda x: weight[..., None] * x, image)
            (back,) = transposed(weighted)
            return total(back) + self.damping * vector

        return product

    def _length(self, backtracks: Int[Array, ""]) -> Float[Array, ""]:
        """Return the length of a candidate as a share of the first one's."""
        return self.backtrack_ratio ** backtracks.astype(float)

    def _line_search(
        self,
        evaluate: Callable[[Vector], Candidate],
        flat: Vector,
        longest: Vector,
        loss_before: Float[Array, ""],
    ) -> "_LineSearch":
        """Try ever shorter candidates until one is acceptable."""

        def goes_on(search: _LineSearch) -> Bool[Array, ""]:
            return ~search.accepted & (search.tried < self.max_backtracks)

        def try_next(search: _LineSearch) -> _LineSearch:
            candidate = evaluate(flat + self._length(search.tried) * longest)
            # False for NaN and for a loss of -inf, so a broken candidate is never accepted.
            accepted = (candidate.loss < loss_before) & (candidate.kl < self.max_kl)
            accepted &= jnp.isfinite(candidate.loss)
            return _LineSearch(search.tried + 1, accepted, candidate)

        unmoved = Candidate(loss_before, jnp.zeros_like(loss_before))
        start = _LineSearch(jnp.zeros((), int), jnp.zeros((), bool), unmoved)
        return jax.lax.while_loop(goes_on, try_next, start)


class _LineSearch(NamedTuple):
    """State of the backtracking line search."""

    tried: Int[Array, ""]
    """Number of candidates so far."""
    accepted: Bool[Array, ""]
    """Whether the last one is acceptable."""
    last: Candidate
