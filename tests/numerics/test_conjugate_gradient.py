"""Conjugate gradients against SciPy's, direct solutions and degenerate systems."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse.linalg

from maesn.numerics import conjugate_gradient

SIZE = 8


class Solved(NamedTuple):
    solution: jax.Array
    residual_norm: jax.Array


def _system(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A symmetric positive definite matrix with eigenvalues from 0.5 to 4, and a target."""
    generator = np.random.default_rng(seed)
    basis, _ = np.linalg.qr(generator.normal(size=(SIZE, SIZE)))
    matrix = basis @ np.diag(np.linspace(0.5, 4.0, SIZE)) @ basis.T
    return matrix, generator.normal(size=SIZE)


def _solve(
    matrix: np.ndarray | jax.Array,
    target: np.ndarray | jax.Array,
    num_steps: int,
    residual_tolerance: float = 1e-10,
) -> Solved:
    matrix, target = jnp.asarray(matrix, jnp.float32), jnp.asarray(target, jnp.float32)
    return Solved(*conjugate_gradient(lambda v: matrix @ v, target, num_steps, residual_tolerance))


@pytest.mark.parametrize("num_steps", [0, 1, 2, 3, 5])
def test_every_iterate_agrees_with_scipy(num_steps: int) -> None:
    matrix, target = _system(0)
    expected, _ = scipy.sparse.linalg.cg(matrix, target, rtol=0.0, atol=0.0, maxiter=num_steps)
    np.testing.assert_allclose(_solve(matrix, target, num_steps).solution, expected, atol=1e-5)


def test_residual_norm_is_the_norm_of_the_residual() -> None:
    matrix, target = _system(0)
    actual = _solve(matrix, target, 4)
    expected = np.linalg.norm(target - matrix @ np.float64(actual.solution))
    np.testing.assert_allclose(actual.residual_norm, expected, rtol=1e-3)
    assert expected > 1e-3


@pytest.mark.parametrize("residual_tolerance", [1e-10, 0.0])
def test_steps_after_the_exact_solution_change_nothing(residual_tolerance: float) -> None:
    # One step solves a multiple of the identity, here without any rounding.
    target = np.asarray([1.0, -2.0, 4.0])
    actual = _solve(2.0 * np.eye(3), target, 10, residual_tolerance)
    np.testing.assert_array_equal(actual.solution, target / 2)
    assert actual.residual_norm == 0.0


def test_steps_stop_at_the_tolerance_of_the_squared_norm() -> None:
    matrix, target = _system(0)
    squared_norms = [float(_solve(matrix, target, k).residual_norm) ** 2 for k in range(6)]
    assert squared_norms == sorted(squared_norms, reverse=True)
    between = np.sqrt(squared_norms[2] * squared_norms[3])
    stopped = _solve(matrix, target, 6, residual_tolerance=float(between))
    np.testing.assert_array_equal(stopped.solution, _solve(matrix, target, 3).solution)


@pytest.mark.parametrize("matrix", [np.zeros((2, 2)), -np.eye(2)])
def test_without_positive_curvature_the_solution_stays(matrix: np.ndarray) -> None:
    actual = _solve(matrix, np.asarray([3.0, 4.0]), 10)
    np.testing.assert_array_equal(actual.solution, [0.0, 0.0])
    assert actual.residual_norm == 5.0


def test_a_semidefinite_system_is_solved_where_it_can_be() -> None:
    # The target's part outside the range of the matrix remains as the residual.
    actual = _solve(np.diag([2.0, 0.0]), np.asarray([2.0, 0.0]), 10)
    np.testing.assert_array_equal(actual.solution, [1.0, 0.0])


def test_a_product_that_is_not_finite_is_visible_in_the_solution() -> None:
    actual = _solve(np.full((2, 2), np.nan), np.ones(2), 10)
    assert np.all(np.isnan(actual.solution))
    assert np.all(np.isnan(_solve(np.eye(2), np.full(2, np.nan), 10).solution))


def test_the_product_is_traced_once() -> None:
    traces = 0

    def product(vector: jax.Array) -> jax.Array:
        nonlocal traces
        traces += 1
        return 2.0 * vector

    jax.jit(lambda target: conjugate_gradient(product, target, 10))(jnp.ones(3))
    assert traces == 1


def test_the_solution_is_differentiable_also_when_it_is_exact() -> None:
    gradient = jax.grad(lambda target: jnp.sum(_solve(2.0 * np.eye(3), target, 5).solution))(
        jnp.asarray([1.0, -2.0, 4.0], jnp.float32)
    )
    np.testing.assert_allclose(gradient, np.full(3, 0.5), rtol=1e-6)


def test_vmap_over_systems_equals_one_system_at_a_time() -> None:
    # The identity is solved after one step, the others are not: lanes stop independently.
    systems = [_system(0), _system(1), (np.eye(SIZE), np.ones(SIZE))]
    matrices, targets = (np.stack(arrays) for arrays in zip(*systems, strict=True))
    actual = jax.vmap(lambda a, b: _solve(a, b, 4))(jnp.asarray(matrices), jnp.asarray(targets))
    expected = [_solve(matrix, target, 4) for matrix, target in systems]
    np.testing.assert_allclose(actual.solution, [e.solution for e in expected], atol=1e-5)
    np.testing.assert_allclose(actual.residual_norm, [e.residual_norm for e in expected], atol=1e-5)
