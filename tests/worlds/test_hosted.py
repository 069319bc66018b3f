"""What a worker takes from an environment, and what it refuses."""

import pickle
import warnings
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from maesn.foreign.errors import described
from maesn.foreign.hosted import HostedEnvironment, HostedError

ACTIONS = spaces.Box(-1.0, 1.0, (1,), np.float32)


class Constant(gymnasium.Env[Any, Any]):
    """Always returns the same."""

    def __init__(self, value: np.ndarray, reward: float) -> None:
        binary = value.dtype == bool
        bounds = (0, 1) if binary else (-np.inf, np.inf)
        if value.dtype.kind == "i":
            bounds = np.iinfo(value.dtype).min, np.iinfo(value.dtype).max
        self.observation_space = (
            spaces.MultiBinary(value.shape)
            if binary
            else spaces.Box(*bounds, value.shape, value.dtype.type)
        )
        self.action_space = ACTIONS
        self.value, self.reward = value, reward

    def reset(self, **_: Any) -> tuple[np.ndarray, dict[str, Any]]:
        return self.value, {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        return self.value, self.reward, False, False, {}


def constant(value: np.ndarray, reward: float, task: Any, kind: str) -> Constant:
    return Constant(value, reward)


def hosted(value: np.ndarray, reward: float = 0.0) -> HostedEnvironment:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of Gymnasium, about the precision of bounds
        one = HostedEnvironment(partial(constant, value, reward), "dense", None)
        one.describe(pickle.dumps(None))
    return one


@pytest.mark.parametrize(
    "value",
    [
        np.array([-128, 127], np.int8),
        np.array([True, False]),
        np.array([60_000.0], np.float16),
        np.array([3e38, -3e38]),
        np.array([[1, 2], [3, 4]], np.int64),
    ],
    ids=str,
)
def test_numbers_of_all_kinds_become_single_precision(value: np.ndarray) -> None:
    reading = hosted(value).begin(pickle.dumps(None), 0)
    assert reading.observation.dtype == np.float32
    np.testing.assert_array_equal(reading.observation, value.ravel().astype(np.float32))


@pytest.mark.parametrize("number", [np.inf, -np.inf, np.nan, 1e39])
@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64])
def test_what_is_infinite_in_single_precision_is_refused(number: float, kind: Any) -> None:
    with np.errstate(over="ignore"):
        value = np.array([0.0, number], kind)
    with pytest.raises(HostedError, match="the observation is not finite: component 1 is"):
        hosted(value).begin(pickle.dumps(None), 0)


@pytest.mark.parametrize("reward", [np.inf, np.nan, 1e39, -1e39])
def test_a_reward_that_is_infinite_in_single_precision_is_refused(reward: float) -> None:
    one = hosted(np.zeros(1, np.float32), reward)
    one.begin(pickle.dumps(None), 0)
    with pytest.raises(HostedError, match="the reward is not finite"):
        one.step(np.zeros(1, np.float32))


class Nameless(Exception):
    """Cannot even say what it is."""

    def __str__(self) -> str:
        raise RuntimeError


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (ValueError("x"), "ValueError: x"),
        (Nameless(), "Nameless: (its message cannot be shown)"),
        (ValueError("a" + "b" * 10_000_000 + "c"), "ValueError: ab"),
    ],
)
def test_an_error_is_described_in_few_characters(error: Exception, said: str) -> None:
    text = described(error)
    assert text.startswith(said)
    assert len(text) < 1100
    if len(text) > 100:
        assert text.endswith("bc")
        assert "bb ... (9,999,014 characters left out) ... bb" in text
