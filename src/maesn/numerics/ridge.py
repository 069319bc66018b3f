"""Ridge regression in single precision, for features of very different scales."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float

from maesn.numerics.conjugate_gradient import conjugate_gradient
from maesn.numerics.products import multiply

# Diagonal added to the equilibrated Gram matrix, in units of ε. Rounding moves its eigenvalues by
# up to 20 ε (measured in single precision with features like the wheeled robot's and the ant's).
# A larger jitter weakens the preconditioner and asks for more refinement steps.
_JITTER = 32.0

# In single precision predictions stop improving after 5 steps with 28 features like the wheeled
# robot's (4000 rows) and after 12 with 254 features like the ant's (10000 rows).
_REFINEMENT_STEPS = 12


def ridge_regression(
    features: Float[Array, "row feature"],
    target: Float[Array, "row"],
    weight: Float[Array, "row"],
    ridge: float,
) -> Float[Array, "feature"]:
    """Coefficients of the weighted ridge regression.

        w = argmin_w Σ_n m_n (y_n - x_n·w)² + ρ ‖w‖²,  n in [1, N]

    The normal equations (XᵀX + ρI) w = Xᵀy of states, their squares and powers of time are too
    ill-conditioned for single precision as they stand. So

    1. columns are scaled by s_j = 1/√(‖X_j‖² + ρ), which gives the system a unit diagonal;
    2. the scaled system plus a jitter is factorised, L Lᵀ = S (XᵀX + ρI) S + jitter I;
    3. conjugate gradients, preconditioned by L, refine the solution with products and residuals
       computed from X itself, so that neither the jitter nor the rounding of XᵀX remains in w.

    Refinement by conjugate gradients on the rows is described by Björck, "Numerical methods for
    least squares problems" (1996), chapter 7.4; scaling by van der Sluis, "Condition numbers and
    equilibration of matrices" (1969).

    Args:
        features: x_n, the rows of X.
        target: y_n.
        weight: m_n >= 0, usually a mask of 0 and 1. Rows of weight 0 are ignored, NaN included.
        ridge: ρ > 0, in the squared unit of the features. It is not scaled with N.

    Returns:
        w; 0 for columns that are zero.
    """
    is_used = weight > 0.0
    root = jnp.sqrt(jnp.where(is_used, weight, 0.0))
    rows = jnp.where(is_used[:, None], features, 0.0) * root[:, None]
    target = jnp.where(is_used, target, 0.0) * root
    gram = multiply(rows.T, rows)
    scale = jax.lax.rsqrt(jnp.diagonal(gram) + ridge)
    factor = _factorize(gram * scale[:, None] * scale[None, :])

    def whiten(vector: Float[Array, "feature"]) -> Float[Array, "feature"]:
        return solve_triangular(factor, scale * vector, lower=True)

    def unwhiten(vector: Float[Array, "feature"]) -> Float[Array, "feature"]:
        return scale * solve_triangular(factor, vector, lower=True, trans="T")

    def product(vector: Float[Array, "feature"]) -> Float[Array, "feature"]:
        coefficients = unwhiten(vector)
        return whiten(multiply(multiply(rows, coefficients), rows) + ridge * coefficients)

    first = unwhiten(whiten(multiply(target, rows)))
    residual = multiply(target - multiply(rows, first), rows) - ridge * first
    refinement, _ = conjugate_gradient(
        product, whiten(residual), num_steps=_REFINEMENT_STEPS, residual_tolerance=0.0
    )
    return first + unwhiten(refinement)


def _factorize(scaled: Float[Array, "feature feature"]) -> Float[Array, "feature feature"]:
    """Lower Cholesky factor of a matrix of unit diagonal, made positive definite by a jitter.

    Cholesky answers with NaN if rounding has made the matrix indefinite in spite of the jitter.
    Then the jitter is multiplied by the number of columns, which bounds the norm of a matrix whose
    elements are all rounded by `_JITTER` ε.
    """
    size = scaled.shape[0]
    jitter = _JITTER * float(np.finfo(scaled.dtype).eps)
    diagonal = jnp.diag_indices(size)
    usual = jnp.linalg.cholesky(scaled.at[diagonal].set(1.0 + jitter))
    cautious = jnp.linalg.cholesky(scaled.at[diagonal].set(1.0 + jitter * size))
    return jnp.where(jnp.all(jnp.isfinite(usual)), usual, cautious)
