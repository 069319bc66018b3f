"""Advantages over trials against plain loops over the steps that were played."""

import jax.numpy as jnp
import numpy as np
import pytest

from maesn.numerics import generalized_advantages, trial_advantages

DISCOUNT, TRACE = 0.9, 0.7
PLAYED = {
    "all": [True] * 9,
    "first episode ends early": [True, True, False, True, True, True, True, True, True],
    "every episode does": [True, False, False, True, True, False, True, False, False],
    "one is never alive": [True, True, True, False, False, False, True, True, False],
}


def brute_force(reward: np.ndarray, value: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Sums of discounted differences over the steps that were played, one by one."""
    steps = np.flatnonzero(valid)
    advantages = np.zeros(len(valid))
    for i, start in enumerate(steps):
        for distance, step in enumerate(steps[i:]):
            later = steps[i + distance + 1 :]
            following = value[later[0]] if len(later) else 0.0
            difference = reward[step] + DISCOUNT * following - value[step]
            advantages[start] += (DISCOUNT * TRACE) ** distance * difference
    return advantages


def random_trial() -> tuple[np.ndarray, np.ndarray]:
    stream = np.random.default_rng(0)
    return stream.normal(size=(2, 9)).astype(np.float32)


@pytest.mark.parametrize("name", PLAYED)
def test_brute_force(name: str) -> None:
    (reward, value), valid = random_trial(), np.array(PLAYED[name])
    garbage = [jnp.asarray(np.where(valid, x, np.nan)) for x in (reward, value)]
    actual = trial_advantages(*garbage, jnp.asarray(valid), DISCOUNT, TRACE)
    np.testing.assert_allclose(actual, brute_force(reward, value, valid), rtol=1e-5, atol=1e-6)


def test_with_trace_one_it_is_the_return_of_the_whole_trial_less_the_value() -> None:
    reward, value = random_trial()
    valid = jnp.ones(9, bool)
    actual = trial_advantages(jnp.asarray(reward), jnp.asarray(value), valid, DISCOUNT, 1.0)
    returns = [sum(DISCOUNT**k * r for k, r in enumerate(reward[t:])) for t in range(9)]
    np.testing.assert_allclose(actual, np.array(returns) - value, rtol=1e-5, atol=1e-6)


def test_a_trial_of_one_episode_is_the_usual_estimate() -> None:
    (reward, value), valid = random_trial(), jnp.arange(9) < 6
    arrays = [jnp.asarray(x) for x in (reward, value)]
    usual = generalized_advantages(*arrays, valid, DISCOUNT, TRACE)
    np.testing.assert_allclose(
        trial_advantages(*arrays, valid, DISCOUNT, TRACE), usual, rtol=1e-5, atol=1e-6
    )
