"""The baseline on what a real ant sees, in single precision, against double precision.

Its 254 features are nearly dependent: the rotation matrix on products of the quaternion, the centre
of mass on the torso's place, and most contact forces are zero.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from playing import agents, play

from maesn.envs import Ant, ant
from maesn.experience.episodes import Episodes
from maesn.inner.advantage import AdvantageEstimator, _features
from maesn.numerics import discounted_returns, ridge_regression

EPISODES = 12


@pytest.fixture(scope="module")
def episodes() -> Episodes:
    env = Ant()
    played = play(env, ant.task_set("test"), [0], episodes=EPISODES, cast=agents(env, 1))
    return jax.tree.map(lambda leaf: leaf[0], played)


def double_precision(features: np.ndarray, target: np.ndarray, ridge: float) -> np.ndarray:
    """Fitted values of least squares with sqrt(ridge) I appended, by singular values."""
    size = features.shape[1]
    rows = np.concatenate([features, np.sqrt(ridge) * np.eye(size)])
    solution = np.linalg.lstsq(rows, np.concatenate([target, np.zeros(size)]), rcond=None)[0]
    return features @ solution


def test_fitted_values_agree_with_double_precision(episodes: Episodes) -> None:
    ridge = AdvantageEstimator().ridge
    returns = jax.vmap(discounted_returns, (0, 0, None))(episodes.reward, episodes.valid, 0.99)
    features = _features(episodes.observation[:, :-1], episodes.valid).reshape(-1, 254)
    target, weight = returns.reshape(-1), episodes.valid.reshape(-1).astype(jnp.float32)
    fit = jax.jit(ridge_regression, static_argnums=3)
    actual = np.float64(features @ fit(features, target, weight, ridge))
    valid = np.asarray(weight) > 0
    rows = np.float64(features)[valid]
    # Singular in single precision, or the test would show nothing.
    scale = 1 / np.sqrt((rows**2).sum(0) + ridge)
    gram = scale[:, None] * (rows.T @ rows + ridge * np.eye(254)) * scale
    assert np.linalg.cond(gram) > 1e7
    expected = double_precision(rows, np.float64(target)[valid], ridge)
    assert np.corrcoef(actual[valid], expected)[0, 1] > 0.9999
    assert np.sqrt(np.mean((actual[valid] - expected) ** 2)) < 5e-3 * expected.std()
