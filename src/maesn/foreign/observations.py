"""Whether an observation is an element of its space, up to bounds and types of its numbers.

Gymnasium's `Space.contains` asks for exact types and bounds, which environments often miss by
little; its `flatten` asks for nothing, and takes numbers of one part for those of another.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces


def fault(space: spaces.Space[Any], value: Any, where: str = "the observation") -> str | None:
    """Return what is wrong with an observation, as a sentence; None if nothing is.

    Args:
        space: of the observation, which flattens to a vector.
        value: what the environment has returned.
        where: what the sentence calls the observation.
    """
    if isinstance(space, spaces.Dict):
        return _fault_of_dictionary(space.spaces, value, where)
    if isinstance(space, spaces.Tuple):
        return _fault_of_tuple(space.spaces, value, where)
    if isinstance(space, spaces.Discrete):
        return _fault_of_choice(space, value, where)
    if space.shape is not None and np.shape(value) != space.shape:
        return f"{where} must have the shape {space.shape} of its space, got {np.shape(value)}"
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
    if not isinstance(value, Sequence) or len(value) != len(parts):
        return f"{where} must be a tuple of {len(parts)} parts, got {value!r}"
    pairs = enumerate(zip(parts, value, strict=True))
    faults = (fault(part, item, f"{where}[{index}]") for index, (part, item) in pairs)
    return next(filter(None, faults), None)


def _fault_of_choice(space: spaces.Discrete, value: Any, where: str) -> str | None:
    first, last = int(space.start), int(space.start + space.n) - 1
    if np.shape(value) == () and float(value).is_integer() and first <= value <= last:
        return None
    return f"{where} must be a whole number from {first} to {last}, got {value!r}"
