"""Checked conversion of what comes from outside: observations, rewards, arrays of a file."""

from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray: TypeAlias = NDArray[np.float64]
LimitArray: TypeAlias = Annotated[FloatArray, "infinite where there is no limit"]
Arrays: TypeAlias = dict[str, NDArray[np.generic]]

LARGEST = 1e100
"""The squares of larger numbers, summed over many steps or draws, are beyond double precision."""


def float64(values: Any) -> FloatArray:
    """Return an array, of JAX as well, in double precision."""
    return np.asarray(values, np.float64)


def finite_vector(name: str, values: ArrayLike, size: int, reason: str) -> FloatArray:
    """Return a copy of `values` in double precision; raises ValueError for NaN or another size.

    A copy, because robots reuse their buffers: `data.qpos` of a simulator is overwritten in place.
    Messages use the name of the argument, and the reason for its size.
    """
    try:
        vector = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"`{name}` must hold {size} numbers, got {values!r}.") from error
    if vector.shape != (size,):
        raise ValueError(
            f"`{name}` must have shape ({size},), {reason}, but has shape {vector.shape}."
        )
    finite = np.isfinite(vector)
    if not finite.all():
        index = int(np.argmin(finite))
        raise ValueError(
            f"`{name}` must be finite, but component {index} is {vector[index]}. Nothing was "
            "recorded: give finite values."
        )
    return vector


def check_shapes(owner: object, shape: tuple[int, ...], *fields: str) -> None:
    """Raise ValueError if a field of arrays, or of names, has another shape."""
    for field in fields:
        found = np.shape(getattr(owner, field))
        if found != shape:
            name = f"{type(owner).__name__}.{field}"
            raise ValueError(f"`{name}` must have the shape {shape}, but has {found}.")
