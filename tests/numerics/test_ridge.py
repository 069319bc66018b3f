"""Ridge regression in single precision against least squares in double precision."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from maesn.numerics import ridge_regression
from maesn.numerics.ridge import _factorize

RIDGE = 1e-5  # the reference implementation's
HORIZON = 200

_compiled = jax.jit(ridge_regression, static_argnames="ridge")

Problem = tuple[np.ndarray, np.ndarray]


def _problem(observation: np.ndarray, reward: np.ndarray) -> Problem:
    """Features (o, o², t/100, its square and cube, 1) and discounted returns, single precision."""
    time = np.broadcast_to(np.arange(HORIZON)[:, None] / 100, (*observation.shape[:2], 1))
    observation = np.clip(observation, -10, 10)
    columns = [observation, observation**2, time, time**2, time**3, np.ones_like(time)]
    features = np.concatenate(columns, axis=-1).reshape(observation.shape[0] * HORIZON, -1)
    backwards = reward[:, ::-1]
    returns = scipy.signal.lfilter([1.0], [1.0, -0.99], backwards, axis=1)[:, ::-1]
    return features.astype(np.float32), returns.reshape(-1).astype(np.float32)


def _wheeled_like(seed: int, episodes: int = 20) -> Problem:
    """Random walks of 12 coordinates, one of them a height that hardly changes."""
    generator = np.random.default_rng(seed)
    scales = np.asarray([0.02] * 3 + [0.05] * 3 + [0.3] * 6)
    walk = np.cumsum(scales * generator.normal(size=(episodes, HORIZON, 12)), axis=1)
    walk[..., 3] = 0.26 + 1e-3 * generator.normal(size=walk.shape[:2])
    return _problem(walk, -np.hypot(walk[..., 0] - 1, walk[..., 1] - 2))


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """Entries of the rotation matrix: linear in the squares that are features themselves."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    entries = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return np.stack(entries, axis=-1)


def _ant_like(seed: int, episodes: int = 50) -> Problem:
    """125 coordinates: 60 that stay zero, 10 tiny ones from 1e-4 down to 3e-9, near copies."""
    generator = np.random.default_rng(seed)
    shape = (episodes, HORIZON)
    position = np.cumsum(0.02 * generator.normal(size=(*shape, 2)), axis=1)
    height = 0.55 + 0.01 * generator.normal(size=(*shape, 1))
    turn = np.cumsum(0.01 * generator.normal(size=(*shape, 4)), axis=1)
    quaternion = np.asarray([1.0, 0.0, 0.0, 0.0]) + turn
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    joints = np.tanh(np.cumsum(0.05 * generator.normal(size=(*shape, 8)), axis=1))
    velocity = generator.normal(size=(*shape, 14)) * np.asarray([0.1] * 6 + [3.0] * 8)
    contact = np.zeros((*shape, 84))
    is_hit = generator.random((*shape, 14)) < 0.05
    contact[..., :14] = is_hit * np.clip(5 * generator.normal(size=(*shape, 14)), -1, 1)
    contact[..., 14:24] = np.logspace(-4, -8.5, 10) * generator.normal(size=(*shape, 10))
    centre = np.concatenate([position, height], axis=-1)
    centre = centre + 1e-3 * generator.normal(size=(*shape, 3))
    parts = [position, height, quaternion, joints, velocity, contact]
    observation = np.concatenate([*parts, _rotation(quaternion), centre], axis=-1)
    return _problem(observation, 4 - np.abs(centre[..., :2] - [1.0, 1.5]).sum(axis=-1))


def _exact(features: np.ndarray, target: np.ndarray, ridge: float = RIDGE) -> np.ndarray:
    """Least squares of the system with √ρ I appended, by singular values, double precision."""
    size = features.shape[1]
    rows = np.concatenate([np.float64(features), np.sqrt(ridge) * np.eye(size)])
    return np.linalg.lstsq(rows, np.concatenate([target, np.zeros(size)]), rcond=None)[0]


def _solve(
    features: np.ndarray, target: np.ndarray, weight: np.ndarray | None = None, ridge: float = RIDGE
) -> np.ndarray:
    weight = np.ones(len(target)) if weight is None else weight
    arguments = [jnp.asarray(x, jnp.float32) for x in (features, target, weight)]
    coefficients = _compiled(*arguments, ridge=ridge)
    assert coefficients.dtype == jnp.float32
    return np.float64(coefficients)


def _small(seed: int = 0, rows: int = 30, columns: int = 4) -> Problem:
    generator = np.random.default_rng(seed)
    return generator.normal(size=(rows, columns)), generator.normal(size=rows)


@pytest.mark.parametrize(
    ("make", "shape", "num_negligible", "tolerance"),
    [(_wheeled_like, (4000, 28), 0, 1e-4), (_ant_like, (10000, 254), 140, 2e-3)],
)
def test_predictions_in_single_precision_agree_with_double_precision(
    make: Callable[[int], Problem], shape: tuple[int, int], num_negligible: int, tolerance: float
) -> None:
    features, target = make(4)
    assert features.shape == shape
    assert np.sum(np.max(np.abs(features), axis=0) < 1e-3) == num_negligible
    # Beyond 1e7 = 1/ε the equilibrated normal equations are singular in single precision.
    gram = np.float64(features).T @ np.float64(features) + RIDGE * np.eye(shape[1])
    scale = 1 / np.sqrt(np.diag(gram))
    assert np.linalg.cond(scale[:, None] * gram * scale) > 1e7

    expected = np.float64(features) @ _exact(features, target)
    actual = np.float64(features) @ _solve(features, target)
    assert np.corrcoef(actual, expected)[0, 1] > 0.9999
    assert np.sqrt(np.mean((actual - expected) ** 2)) < tolerance * expected.std()


def test_orthogonal_columns_have_the_closed_form() -> None:
    # w_j = X_j·y / (‖X_j‖² + ρ)
    features = np.asarray([[2.0, 0.0], [0.0, 3.0], [0.0, 0.0]])
    actual = _solve(features, np.asarray([5.0, 7.0, 11.0]), ridge=1.0)
    np.testing.assert_allclose(actual, [10 / 5, 21 / 10], rtol=1e-6)


@pytest.mark.parametrize("garbage", [np.nan, np.inf, 1e30])
def test_rows_of_weight_zero_change_nothing(garbage: float) -> None:
    features, target = _small()
    weight = np.where(np.arange(30) % 3 == 0, 0.0, 1.0)
    spoilt_features = np.where(weight[:, None] == 0, garbage, features)
    spoilt_target = np.where(weight == 0, garbage, target)
    clean = np.where(weight[:, None] == 0, 0.0, features), np.where(weight == 0, 0.0, target)
    actual = _solve(spoilt_features, spoilt_target, weight)
    np.testing.assert_array_equal(actual, _solve(*clean, weight))
    kept = weight == 1
    np.testing.assert_allclose(actual, _exact(features[kept], target[kept]), atol=1e-5)


def test_zero_columns_get_zero_and_leave_the_others_alone() -> None:
    features, target = _small()
    padded = np.insert(features, [0, 2], 0.0, axis=1)
    actual = _solve(padded, target)
    np.testing.assert_array_equal(actual[[0, 3]], [0.0, 0.0])
    np.testing.assert_allclose(np.delete(actual, [0, 3]), _solve(features, target), atol=1e-6)


def test_no_rows_give_zero() -> None:
    features, target = _small()
    actual = _solve(features, target, np.zeros(30))
    np.testing.assert_array_equal(actual, np.zeros(4))


def test_vmap_over_tasks_equals_one_task_at_a_time() -> None:
    problems = [_wheeled_like(seed, episodes=3) for seed in range(3)]
    features, targets = (np.stack(arrays) for arrays in zip(*problems, strict=True))
    weight = jnp.ones(features.shape[1], jnp.float32)
    batched = jax.jit(jax.vmap(lambda x, y: ridge_regression(x, y, weight, RIDGE)))
    coefficients = np.float64(batched(jnp.asarray(features), jnp.asarray(targets)))
    for index, (x, y) in enumerate(problems):
        expected = x @ _solve(x, y)
        error = np.sqrt(np.mean((x @ coefficients[index] - expected) ** 2))
        assert error < 1e-4 * expected.std()


def test_a_gram_matrix_that_rounding_made_indefinite_is_still_factorized() -> None:
    # Eigenvalues 1 - (n-1)a and 1 + a, the first of them -5e-6: below the usual jitter of 4e-6.
    size = 28
    coupling = (1 + 5e-6) / (size - 1)
    scaled = np.full((size, size), -coupling) + (1 + coupling) * np.eye(size)
    factor = np.float64(_factorize(jnp.asarray(scaled, jnp.float32)))
    np.testing.assert_allclose(factor @ factor.T, scaled, atol=2e-4)


def test_nan_in_a_used_row_is_visible() -> None:
    features, target = _small()
    features[3, 2] = np.nan
    assert np.all(np.isnan(_solve(features, target)))
