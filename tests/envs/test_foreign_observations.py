"""Whether an observation is one of its space: against Gymnasium, and case by case."""

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from maesn.foreign.observations import fault

CHOICE = spaces.Discrete(3, start=-1)
CHOICES = spaces.MultiDiscrete([3, 2], start=[0, 5])
SWITCHES = spaces.MultiBinary(2)
PIXELS = spaces.Box(0, 255, (2,), np.uint8)
PAIR = spaces.Tuple((CHOICE, CHOICE))
NAMED = spaces.Dict({"at": spaces.Box(-1, 1, (2,)), "gear": CHOICE})

WRONG: list[tuple[spaces.Space[Any], Any, str]] = [
    (CHOICE, 2, "must be a whole number from -1 to 1, got 2"),
    (CHOICE, 1.0, "must be a whole number from -1 to 1, got 1.0"),
    (CHOICE, None, "must be a whole number from -1 to 1, got None"),
    (CHOICE, "1", "must be a whole number from -1 to 1, got '1'"),
    (CHOICE, np.array([1]), "must have the shape () of its space, got (1,)"),
    (CHOICES, np.array([3, 5]), "must be a whole number from [0 5] to [2 6]"),
    (CHOICES, np.array([0, 4]), "must be a whole number from [0 5] to [2 6]"),
    (CHOICES, np.array([0]), "must have the shape (2,) of its space, got (1,)"),
    (SWITCHES, np.array([0, 2]), "must hold 0 or 1"),
    (PIXELS, np.array([0, -1]), "must hold numbers of the type uint8"),
    (PIXELS, np.array([0, np.nan]), "must hold numbers of the type uint8"),
    (PIXELS, np.array([0, 0.5]), "must hold numbers of the type uint8"),
    (spaces.Box(-1, 1, (1,)), np.array(["a"]), "must hold numbers"),
    (PAIR, (0,), "must be a tuple of 2 parts"),
    (PAIR, "01", "must be a tuple of 2 parts"),
    (PAIR, (0, 5), "[1] must be a whole number"),
    (NAMED, {"at": np.zeros(2)}, "must have the parts at, gear, got at"),
    (NAMED, np.zeros(3), "must be a dictionary of at, gear"),
    (NAMED, {"at": np.zeros(3), "gear": 0}, "['at'] must have the shape (2,) of its space"),
]


@pytest.mark.parametrize(("space", "value", "said"), WRONG)
def test_what_is_wrong_is_said(space: spaces.Space[Any], value: Any, said: str) -> None:
    found = fault(space, value)
    assert found is not None
    assert found.startswith("the observation")
    assert said in found


OTHERS = (spaces.Text(4), spaces.Box(0, 1, (0,)))


@pytest.mark.parametrize("space", [CHOICE, CHOICES, SWITCHES, PIXELS, PAIR, NAMED, *OTHERS])
def test_gymnasiums_own_samples_are_right(space: spaces.Space[Any]) -> None:
    space.seed(0)
    for _ in range(20):
        assert fault(space, space.sample()) is None


def test_what_gymnasium_finds_too_strict_is_right_as_well() -> None:
    assert fault(PAIR, np.array([1, -1])) is None
    assert fault(PAIR, [1, np.int8(-1)]) is None
    assert fault(SWITCHES, np.array([True, False])) is None
    assert fault(PIXELS, np.array([3.0, 4.0])) is None  # whole numbers, whatever their type
    assert fault(spaces.Box(0, 1, (2,)), np.array([7, -7])) is None  # bounds count for nothing
    assert fault(spaces.Discrete(255, start=np.uint8(1), dtype=np.uint8), np.uint8(255)) is None
