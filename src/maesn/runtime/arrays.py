"""Checked conversion of what comes from outside: observations, rewards, arrays of a file."""

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray: TypeAlias = NDArray[np.float64]
Arrays: TypeAlias = dict[str, NDArray[np.generic]]


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


def named(prefix: str, value: object, *fields: str) -> Arrays:
    """Return some fields of a value under the names that they have in a file."""
    return {f"{prefix}.{field}": getattr(value, field) for field in fields}


def taken(arrays: Arrays, prefix: str, size: int, *fields: str, **options: bool) -> dict[str, Any]:
    """Return vectors of a file, `[size]`, as the arguments of what they are fields of."""
    return {field: take(arrays, f"{prefix}.{field}", size, **options) for field in fields}


def take(
    arrays: Mapping[str, NDArray[np.generic]], name: str, *shape: int, allow_infinite: bool = False
) -> FloatArray:
    """Return one array of a file in double precision; a size of its shape that is -1 may be any.

    Raises:
        ValueError: it is missing, of another shape, not a number, or infinite without
            `allow_infinite`, which is for limits that do not exist.
    """
    if name not in arrays:
        raise ValueError(f"array `{name}` is missing from the file; write it again.")
    array = arrays[name]
    wanted = tuple("any" if size < 0 else size for size in shape)
    fits = array.ndim == len(shape) and all(
        size in (-1, actual) for size, actual in zip(shape, array.shape, strict=True)
    )
    if not fits:
        raise ValueError(f"array `{name}` must have the shape {wanted}, but has {array.shape}.")
    numbers = array.astype(np.float64) if array.dtype.kind in "fiu" else np.full(1, np.nan)
    if not (np.isfinite(numbers) | (allow_infinite & np.isinf(numbers))).all():
        raise ValueError(f"array `{name}` must hold finite numbers; the file is damaged.")
    return numbers
