"""What a worker takes from an environment, and what it refuses."""

from contextlib import closing
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from maesn.foreign import WorkerError, WorkerPool, pack_task
from maesn.foreign.worker import HostedEnvironment, HostedError, described


class Constant(gymnasium.Env[Any, Any]):
    """Always returns the same."""

    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def __init__(self, value: np.ndarray, reward: float, task: Any, kind: str) -> None:
        self.observation_space = spaces.Box(-np.inf, np.inf, value.shape, np.float32)
        self.value, self.reward = value, reward

    def reset(self, **_: Any) -> tuple[np.ndarray, dict[str, Any]]:
        return self.value, {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        return self.value, self.reward, False, False, {}


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (np.zeros(3), "the observation must have the shape (2,) of its space, got (3,)"),
        (np.array(["a", "b"]), "the observation must hold numbers"),
        ([[0.0], [0.0, 1.0]], "the observation raised ValueError"),
        (None, "the observation must have the shape (2,) of its space, got ()"),
    ],
)
def test_what_is_wrong_with_an_observation_is_said(value: Any, said: str) -> None:
    hosted = HostedEnvironment(partial(Constant, np.zeros(2), 0.0), "dense")
    hosted.facts(pack_task(None))
    hosted._env.value = value
    with pytest.raises(HostedError) as error:
        hosted.begin(pack_task(None), 0)
    assert str(error.value).startswith(said)


@pytest.mark.parametrize("kind", [np.int8, bool, np.float16, np.float64, np.int64])
def test_numbers_of_all_kinds_become_single_precision(kind: Any) -> None:
    value = np.array([[0, 1], [1, 0]], kind)
    reading = HostedEnvironment(partial(Constant, value, 0.0), "dense").begin(pack_task(None), 0)
    assert reading.dtype == np.float32
    np.testing.assert_array_equal(reading[:-4], value.ravel())


@pytest.mark.parametrize(("number", "reward"), [(np.nan, 0.0), (1e39, 0.0), (0.0, -1e39)])
def test_what_is_infinite_in_single_precision_is_refused(number: float, reward: float) -> None:
    make_env = partial(Constant, np.array([0.0, number]), reward)
    what = "the reward is not finite" if reward else "the observation is not finite: component 1 is"
    with closing(WorkerPool(make_env, "dense", None, 1, 60.0)) as pool:
        if reward:
            pool.begin([pack_task(None)], [0])
        ask = partial(pool.step, np.zeros((1, 1), np.float32))
        with pytest.raises(WorkerError, match=what):
            ask() if reward else pool.begin([pack_task(None)], [0])


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
