"""Whether an observation is an element of its space, up to the bounds of its numbers.

Gymnasium's `Space.contains` asks for exact types and bounds, which environments often miss by
little; its `flatten` asks for nothing, and takes numbers of one part for those of another.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces


def fault(space: spaces.Space[Any], value: Any, where: str = "the observation") -> str | None:
    """Return what is wrong with an observation, as a sentence; None if nothing is.

    Spaces of other kinds than those below are not looked into.

    Args:
        space: space of the observation, which flattens to a vector.
        value: the observation that the environment has returned.
        where: the name of the observation in the sentence.
    """
    if isinstance(space, spaces.Box | spaces.MultiBinary):
        return _fault_of_numbers(space, value, where)
    if isinstance(space, spaces.Dict):
        return _fault_of_dictionary(space.spaces, value, where)
    if isinstance(space, spaces.Tuple):
        return _fault_of_tuple(space.spaces, value, where)
    if isinstance(space, spaces.Discrete):
        return _fault_of_choices(space, np.asarray(space.n), value, where)
    if isinstance(space, spaces.MultiDiscrete):
        return _fault_of_choices(space, space.nvec, value, where)
    return None


def _fault_of_dictionary(
    parts: Mapping[str, spaces.Space[Any]], value: Any, where: str
) -> str | None:
    names = ", ".join(parts)
    if not isinstance(value, Mapping):
        return f"{where} must be a dictionary of {names}, got {value!r}"
    if set(value) != set(parts):
        return f"{where} must have the parts {names}, got {', '.join(map(str, value))}"
    faults = (fault(part, value[name], f"{where}[{name!r}]") for name, part in parts.items())
    return next(filter(None, faults), None)


def _fault_of_tuple(parts: Sequence[spaces.Space[Any]], value: Any, where: str) -> str | None:
    if not isinstance(value, tuple | list | np.ndarray) or len(value) != len(parts):
        return f"{where} must be a tuple of {len(parts)} parts, got {value!r}"
    pairs = enumerate(zip(parts, value, strict=True))
    faults = (fault(part, item, f"{where}[{index}]") for index, (part, item) in pairs)
    return next(filter(None, faults), None)


def _fault_of_choices(space: Any, counts: np.ndarray, value: Any, where: str) -> str | None:
    chosen, first = np.asarray(value), np.asarray(space.start, np.int64)
    last = first + counts.astype(np.int64) - 1
    if chosen.shape != counts.shape:
        return _fault_of_shape(counts.shape, value, where)
    if chosen.dtype.kind in "biu" and np.all((first <= chosen) & (chosen <= last)):
        return None
    return f"{where} must be a whole number from {first} to {last}, got {value!r}"


def _fault_of_numbers(space: Any, value: Any, where: str) -> str | None:
    numbers = np.asarray(value)
    if numbers.shape != space.shape:
        return _fault_of_shape(space.shape, value, where)
    if numbers.dtype.kind not in "biuf":
        return f"{where} must hold numbers, got {value!r}"
    if space.dtype.kind == "f":
        return None
    with np.errstate(invalid="ignore"):
        kept = numbers.astype(space.dtype)
    binary = isinstance(space, spaces.MultiBinary)
    if np.array_equal(kept, numbers) and not (binary and np.any(kept > 1)):
        return None
    kind = "0 or 1" if binary else f"numbers of the type {space.dtype}"
    return f"{where} must hold {kind}, got {value!r}"


def _fault_of_shape(shape: tuple[int, ...], value: Any, where: str) -> str:
    return f"{where} must have the shape {shape} of its space, got {np.shape(value)}"
