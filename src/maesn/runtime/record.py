"""Records as files hold them: arrays by dotted name, and all else as JSON.

A record is a dataclass of arrays, numbers, texts and records, of tuples of these, and of parts that
may be None. Its type hints say what a file must hold, so reading a file executes nothing.
"""

import reprlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from maesn.runtime.arrays import Arrays

Record = TypeVar("Record")

# Doubles hold every integer that is smaller.
_LARGEST_INTEGER = 2**53


def encoded(record: Any) -> tuple[Arrays, Any]:
    """Return a record as arrays by name, and the rest as values for JSON.

    A list of arrays of one shape is one array. JSON leaves out arrays and what is None.
    """
    arrays: Arrays = {}
    return arrays, _encoded(record, "", arrays)


def decoded(kind: type[Record], arrays: Arrays, document: Any) -> Record:
    """Return the record of a type that `encoded` was given.

    Raises:
        ValueError: a part is missing or unknown, of another type, not finite, or does not fit the
            others. The message names it.
    """
    found: Record = _decoded(document, kind, "", arrays)
    return found


def _encoded(value: Any, name: str, arrays: Arrays) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray | list):
        arrays[name] = np.asarray(value)
        return None
    if is_dataclass(value):
        names = [field.name for field in fields(value)]
        held = {one: _encoded(getattr(value, one), _inside(name, one), arrays) for one in names}
        return {one: part for one, part in held.items() if part is not None}
    if isinstance(value, tuple):
        return [_encoded(item, _inside(name, index), arrays) for index, item in enumerate(value)]
    return dict(value) if isinstance(value, Mapping) else value


def _decoded(value: Any, hint: Any, name: str, arrays: Arrays) -> Any:
    origin, arguments = get_origin(hint) or hint, get_args(hint)
    if origin in (Union, UnionType):
        return _one_of(value, arguments, name, arrays)
    if origin is Annotated:
        return _array(arrays, name, arguments[0], allow_infinite=True)
    if origin is np.ndarray:
        return _array(arrays, name, hint)
    if origin is list:
        return list(np.atleast_1d(_array(arrays, name, arguments[0])))
    if is_dataclass(origin):
        return _record(value, hint, name, arrays)
    if origin in (tuple, Sequence) and isinstance(value, list):
        items = [(_inside(name, index), item) for index, item in enumerate(value)]
        return tuple(_decoded(item, arguments[0], where, arrays) for where, item in items)
    if origin is Mapping and isinstance(value, dict):
        return {
            one: _decoded(part, arguments[1], _inside(name, one), arrays)
            for one, part in value.items()
        }
    return _plain(value, hint, name)


def _one_of(value: Any, hints: tuple[Any, ...], name: str, arrays: Arrays) -> Any:
    if value is None and NoneType in hints:
        return None
    first, *others = [hint for hint in hints if hint is not NoneType]
    for hint in others:
        with suppress(ValueError):
            return _decoded(value, hint, name, arrays)
    return _decoded(value, first, name, arrays)


def _record(document: Any, kind: Any, name: str, arrays: Arrays) -> Any:
    hints = get_type_hints(kind, include_extras=True)
    if not isinstance(document, dict) or not document.keys() <= hints.keys():
        found = reprlib.repr(document)
        raise ValueError(f"entry `{name}` must have no entries but {[*hints]}, got {found}.")
    held = {
        one: _decoded(document.get(one), hint, _inside(name, one), arrays)
        for one, hint in hints.items()
    }
    try:
        return kind(**held)
    except ValueError as error:
        raise ValueError(f"`{name}` is damaged: {error}" if name else str(error)) from error


def _array(arrays: Arrays, name: str, hint: Any, allow_infinite: bool = False) -> NDArray[Any]:
    """Return an array in the precision of its hint, which is `NDArray[precision]`."""
    if name not in arrays:
        raise ValueError(f"array `{name}` is missing from the file; write it again.")
    (precision,) = get_args(get_args(hint)[1])
    array = arrays[name]
    with np.errstate(over="ignore"):
        numbers = array.astype(precision) if array.dtype.kind in "fiu" else np.full(1, np.nan)
    if not (np.isfinite(numbers) | (allow_infinite & np.isinf(numbers))).all():
        raise ValueError(f"array `{name}` must hold finite numbers; the file is damaged.")
    return numbers


def _plain(value: Any, hint: Any, name: str) -> Any:
    if type(value) is int and hint in (int, float) and abs(value) < _LARGEST_INTEGER:
        return hint(value)
    # `type`, not `isinstance`: True is no number of steps. NaN differs from itself.
    fits = value in get_args(hint) if get_origin(hint) is Literal else type(value) is hint
    if hint is Any or (fits and hint is not int and value == value):
        return value
    wanted = hint.__name__ if isinstance(hint, type) else hint
    raise ValueError(f"entry `{name}` must be of type {wanted}, got {reprlib.repr(value)}.")


def _inside(name: str, part: str | int) -> str:
    return f"{name}.{part}" if name else str(part)
