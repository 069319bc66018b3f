"""What a worker takes from an environment, and what it refuses."""

from contextlib import closing
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from maesn.foreign import WorkerError, WorkerPool, pack_task
from maesn.foreign.worker import HostedEnvironment, HostedError, described, flattener

CHOICE = spaces.Discrete(3, start=-1)
CHOICES = spaces.MultiDiscrete([3, 2], start=[0, 5])
SWITCHES = spaces.MultiBinary(2)
PIXELS = spaces.Box(0, 255, (2,), np.uint8)
PAIR = spaces.Tuple((CHOICE, CHOICE))
NAMED = spaces.Dict({"at": spaces.Box(-1, 1, (2,)), "gear": CHOICE})

WRONG: list[tuple[spaces.Space[Any], Any, str]] = [
    (CHOICE, 2, "must hold whole numbers from -1 to 1, got 2"),
    (CHOICE, 0.5, "must hold whole numbers from -1 to 1"),
    (CHOICE, None, "must hold numbers"),
    (CHOICE, np.array([1]), "must have the shape () of its space, got (1,)"),
    (CHOICES, np.array([0, 4]), "must hold whole numbers from [0 5] to [2 6]"),
    (SWITCHES, np.array([0, 2]), "must hold whole numbers from 0 to 1"),
    (PIXELS, np.array([0, -1]), "must hold whole numbers from 0 to 255"),
    (PIXELS, np.array([0, np.nan]), "must hold whole numbers"),
    (spaces.Box(-1, 1, (1,)), np.array(["a"]), "must hold numbers"),
    (PAIR, (0,), "must be a tuple of 0, 1"),
    (PAIR, "01", "must be a tuple of 0, 1"),
    (PAIR, (0, 5), "[1] must hold whole numbers"),
    (NAMED, {"at": np.zeros(2)}, "must be a dictionary of at, gear"),
    (NAMED, np.zeros(3), "must be a dictionary of at, gear"),
    (NAMED, {"at": np.zeros(3), "gear": 0}, "['at'] must have the shape (2,) of its space"),
]


@pytest.mark.parametrize(("space", "value", "said"), WRONG)
def test_what_is_wrong_with_an_observation_is_said(
    space: spaces.Space[Any], value: Any, said: str
) -> None:
    read, _, _ = flattener(space, "the observation")
    with pytest.raises(HostedError) as error:
        read(value)
    assert str(error.value).startswith("the observation")
    assert said in str(error.value)


@pytest.mark.parametrize("space", [CHOICE, CHOICES, SWITCHES, PIXELS, PAIR, NAMED])
def test_observations_are_flattened_as_gymnasium_does(space: spaces.Space[Any]) -> None:
    read, _, names = flattener(space, "the observation")
    space.seed(0)
    for _ in range(20):
        value = space.sample()
        flat = read(value)
        assert flat.shape == (len(names),)
        np.testing.assert_array_equal(flat, spaces.flatten(space, value))


@pytest.mark.parametrize(
    ("space", "value"),
    [
        (PAIR, np.array([1, -1])),
        (SWITCHES, np.array([True, False])),
        (PIXELS, np.array([3.0, 4.0])),  # whole numbers, whatever their type
        (spaces.Box(0, 1, (2,)), np.array([7, -7])),  # bounds count for nothing
        (spaces.Discrete(255, start=np.uint8(1), dtype=np.uint8), np.uint8(255)),
    ],
)
def test_what_gymnasium_finds_too_strict_is_right_as_well(space: Any, value: Any) -> None:
    read, _, names = flattener(space, "the observation")
    assert read(value).shape == (len(names),)


def test_components_have_names_in_their_order() -> None:
    space = spaces.Dict({"place": spaces.Box(-1, 1, (2,)), "gear": CHOICE})
    *names, last = flattener(space, "the observation")[2]
    assert names == [*(f"observation['gear'][{i}]" for i in range(3)), "observation['place'][0]"]
    assert last == "observation['place'][1]"


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
