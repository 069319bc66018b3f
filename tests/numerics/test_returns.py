"""Returns, advantages and masked statistics against loops, SciPy and identities."""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maesn.numerics import discounted_returns, generalized_advantages, masked_mean, standardize

TIME = 12
LENGTHS = (1, 5, TIME)
GARBAGE = (0.0, np.nan, np.inf, -1e30)


def _episode(length: int, garbage: float = 7.0) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Reward, value and valid of one episode, with `garbage` beyond its length."""
    generator = np.random.default_rng(length)
    valid = np.arange(TIME) < length
    reward, value = (np.where(valid, generator.normal(size=TIME), garbage) for _ in range(2))
    return jnp.asarray(reward, jnp.float32), jnp.asarray(value, jnp.float32), jnp.asarray(valid)


def _loop_returns(reward: np.ndarray, length: int, discount: float) -> np.ndarray:
    returns = np.zeros(TIME)
    for t in range(length):
        for k in range(length - t):
            returns[t] += discount**k * float(reward[t + k])
    return returns


def _loop_advantages(
    reward: np.ndarray,
    value: np.ndarray,
    length: int,
    discount: float,
    gae_lambda: float,
) -> np.ndarray:
    """The definition as an explicit double sum, A_t = Σ_k (γλ)ᵏ δ_{t+k}."""
    values = [*np.float64(value)[:length], 0.0]
    errors = [float(reward[t]) + discount * values[t + 1] - values[t] for t in range(length)]
    advantages = np.zeros(TIME)
    for t in range(length):
        for k in range(length - t):
            advantages[t] += (discount * gae_lambda) ** k * errors[t + k]
    return advantages


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("discount", [0.0, 0.9, 1.0])
def test_returns_agree_with_a_double_loop(length: int, discount: float) -> None:
    reward, _, valid = _episode(length)
    expected = _loop_returns(np.asarray(reward), length, discount)
    np.testing.assert_allclose(discounted_returns(reward, valid, discount), expected, atol=1e-5)


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize(
    ("discount", "gae_lambda"), [(0.9, 0.7), (1.0, 0.5), (0.5, 1.0), (0.9, 0.0)]
)
def test_advantages_agree_with_a_double_loop(
    length: int, discount: float, gae_lambda: float
) -> None:
    reward, value, valid = _episode(length)
    actual = generalized_advantages(reward, value, valid, discount, gae_lambda)
    expected = _loop_advantages(np.asarray(reward), np.asarray(value), length, discount, gae_lambda)
    np.testing.assert_allclose(actual, expected, atol=1e-5)


Transform = Callable[[jax.Array, jax.Array, jax.Array], jax.Array]
TRANSFORMS: dict[str, Transform] = {
    "discounted_returns": lambda reward, value, valid: discounted_returns(reward, valid, 0.9),
    "generalized_advantages": lambda reward, value, valid: generalized_advantages(
        reward, value, valid, 0.9, 0.8
    ),
    "masked_mean": lambda reward, value, valid: masked_mean(reward, valid),
    "standardize": lambda reward, value, valid: standardize(reward, valid),
}


@functools.cache
def _result_and_gradients(name: str) -> Callable[..., tuple[jax.Array, tuple[jax.Array, ...]]]:
    """The sum of the weighted results, with its gradients in reward and value."""
    weights = jnp.asarray(np.random.default_rng(9).normal(size=TIME), jnp.float32)

    def loss(reward: jax.Array, value: jax.Array, valid: jax.Array) -> jax.Array:
        return jnp.sum(weights * TRANSFORMS[name](reward, value, valid))

    return jax.jit(jax.value_and_grad(loss, argnums=(0, 1)))


@pytest.mark.parametrize("name", TRANSFORMS)
@pytest.mark.parametrize("garbage", GARBAGE)
def test_garbage_beyond_the_episode_changes_neither_result_nor_gradient(
    name: str, garbage: float
) -> None:
    evaluate = _result_and_gradients(name)
    expected, expected_gradients = evaluate(*_episode(5))
    actual, gradients = evaluate(*_episode(5, garbage))
    np.testing.assert_array_equal(actual, expected)
    for gradient, expected_gradient in zip(gradients, expected_gradients, strict=True):
        np.testing.assert_array_equal(gradient, expected_gradient)
        np.testing.assert_array_equal(gradient[5:], np.zeros(TIME - 5))
    assert np.any(np.asarray(gradients[0][:5]) != 0.0)


@pytest.mark.parametrize("name", TRANSFORMS)
def test_vmap_over_episodes_equals_one_episode_at_a_time(name: str) -> None:
    episodes = [_episode(length) for length in LENGTHS]
    stacked = [jnp.stack(arrays) for arrays in zip(*episodes, strict=True)]
    actual = jax.vmap(TRANSFORMS[name])(*stacked)
    expected = [TRANSFORMS[name](*episode) for episode in episodes]
    np.testing.assert_allclose(actual, expected, rtol=1e-6, atol=1e-6)


def test_masked_mean_agrees_with_the_mean_of_the_selection() -> None:
    generator = np.random.default_rng(0)
    values, valid = generator.normal(size=(4, 6)), generator.random((4, 6)) < 0.6
    arguments = jnp.asarray(values, jnp.float32), jnp.asarray(valid)
    np.testing.assert_allclose(masked_mean(*arguments), values[valid].mean(), rtol=1e-5)


def test_statistics_of_nothing_are_zero() -> None:
    values, valid = jnp.full(3, jnp.nan, jnp.float32), jnp.zeros(3, bool)
    assert masked_mean(values, valid) == 0.0
    np.testing.assert_array_equal(standardize(values, valid), np.zeros(3))


def test_standardize_agrees_with_numpy() -> None:
    generator = np.random.default_rng(0)
    values, valid = 5 + 3 * generator.normal(size=(4, 6)), generator.random((4, 6)) < 0.6
    actual = standardize(jnp.asarray(values, jnp.float32), jnp.asarray(valid))
    selected = values[valid]
    expected = np.zeros_like(values)
    expected[valid] = (selected - selected.mean()) / (selected.std() + 1e-8)
    np.testing.assert_allclose(actual, expected, atol=1e-5)


def test_standardize_adds_epsilon_to_the_standard_deviation() -> None:
    values, valid = jnp.asarray([-2.0, 2.0], jnp.float32), jnp.ones(2, bool)
    np.testing.assert_allclose(standardize(values, valid, epsilon=2.0), [-0.5, 0.5], rtol=1e-6)


@pytest.mark.parametrize("level", [3.1, -393.7, 1e-3])
def test_standardize_does_not_blow_up_the_rounding_of_equal_values(level: float) -> None:
    # One rounded mean is a unit in the last place off, and so is then the standard deviation.
    values, valid = jnp.full((20, 199), level, jnp.float32), jnp.ones((20, 199), bool)
    np.testing.assert_allclose(standardize(values, valid), np.zeros((20, 199)), atol=1e-2)


def test_standardize_of_equal_values_has_a_finite_gradient() -> None:
    def loss(values: jax.Array) -> jax.Array:
        return standardize(values, jnp.asarray([True, True, True, False]))[0]

    gradient = jax.grad(loss)(jnp.asarray([2.0, 2.0, 2.0, np.nan], jnp.float32))
    assert np.all(np.isfinite(gradient))
    assert gradient[3] == 0.0
