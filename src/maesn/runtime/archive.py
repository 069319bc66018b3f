"""The file of a policy or of an explorer: an `.npz` of plain arrays and one JSON text.

Reading it can execute nothing, because pickled objects are refused.
"""

import contextlib
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np
from numpy.typing import NDArray

from maesn.runtime.arrays import Arrays

FORMAT = "maesn-policy"
VERSION = 1
_METADATA = "metadata"

# What `zipfile`, NumPy and JSON raise where a file is damaged, found by flipping its bits.
_UNREADABLE = (
    EOFError,
    KeyError,
    OSError,
    RuntimeError,
    ValueError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)

Kind = TypeVar("Kind")


def write_archive(
    path: str | os.PathLike[str],
    arrays: Mapping[str, NDArray[np.generic]],
    metadata: Mapping[str, Any],
) -> None:
    """Write a file as a whole or not at all: a robot may lose its power at any moment.

    Args:
        path: of the file; one that exists is replaced.
        arrays: arrays of numbers by name.
        metadata: what JSON can hold.

    Raises:
        OSError: the file cannot be written; one that existed is as it was.
    """
    head = {"format": FORMAT, "version": VERSION, "arrays": sorted(arrays)}
    text = json.dumps({**head, **metadata})
    target = Path(path)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **{_METADATA: np.array(text), **arrays})
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
        _sync_directory(target.parent)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def read_archive(path: str | os.PathLike[str]) -> tuple[Arrays, dict[str, Any]]:
    """Return the arrays and the metadata of a file.

    Raises:
        OSError: the file cannot be opened.
        ValueError: it is damaged, something else, or of a version that this one cannot read.
    """
    with Path(path).open("rb") as file:
        try:
            arrays = _read_arrays(file)
            metadata = json.loads(str(arrays.pop(_METADATA)))
        except _UNREADABLE as error:
            raise ValueError(
                "it must be a file written by `maesn export` or `Explorer.save`, but it is "
                f"something else or damaged ({error}); write it again"
            ) from error
    _check_version(metadata)
    # Every array has a checksum, but a damaged table of contents can hide whole arrays.
    missing = set(entry(metadata, "arrays", list)) - set(arrays)
    if missing:
        raise ValueError(f"array `{min(missing)}` is missing from the file; write it again.")
    return arrays, metadata


def entry(metadata: Mapping[str, Any], name: str, kind: type[Kind]) -> Kind:
    """Return one entry of the metadata.

    Args:
        metadata: of a file, or a mapping inside it.
        name: of the entry.
        kind: type that it must have.

    Raises:
        ValueError: it is missing or of another type.
    """
    value = metadata.get(name)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return kind(value)  # type: ignore[call-arg]
    if not isinstance(value, kind):
        raise ValueError(f"entry `{name}` must be of type {kind.__name__}, got {value!r}.")
    return value


def _read_arrays(file: BinaryIO) -> Arrays:
    with zipfile.ZipFile(file) as members:
        damaged = members.testzip()  # before NumPy interprets anything
    if damaged is not None:
        raise zipfile.BadZipFile(f"the checksum of {damaged!r} is wrong")
    file.seek(0)
    with np.load(file, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def _sync_directory(directory: Path) -> None:
    """Make the new name survive a power cut."""
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _check_version(metadata: Any) -> None:
    found = metadata if isinstance(metadata, dict) else {}
    if found.get("format") != FORMAT:
        raise ValueError(f"its format must be {FORMAT!r}, got {found.get('format')!r}.")
    if found.get("version") != VERSION:
        raise ValueError(
            f"its version must be {VERSION}, got {found.get('version')!r}: read it with the "
            "release of maesn that wrote it, or export the run again with this one."
        )
