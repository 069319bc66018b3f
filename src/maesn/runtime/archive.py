"""Files that are written whole or not at all, and `.npz` files of plain arrays.

The file of a policy or of an explorer is such an `.npz` with one JSON text beside the arrays.
Reading it can execute nothing, because pickled objects are refused.
"""

import contextlib
import io
import json
import os
import stat
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maesn.runtime.arrays import Arrays

FORMAT = "maesn-policy"
VERSION = 3
# A file of this suffix was being written when its process died; nothing reads it.
PARTIAL = ".partial"
_METADATA = "metadata"
_HEAD = {"format": FORMAT, "version": VERSION}

# Bytes that the arrays of a file may have in memory. A file of a few kilobytes can state terabytes.
LARGEST_FILE = 2**30
# Levels that a JSON text may have. No file of ours has ten.
DEEPEST = 100

_COMPRESSIONS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}

# What `zipfile`, NumPy and JSON raise where a file is damaged, found by flipping its bits and by
# writing headers that make no sense.
_UNREADABLE = (
    ArithmeticError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


def write_whole(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file so that at any moment, power cuts included, it is the old one or the new one.

    Raises:
        OSError: the file cannot be written; one that existed is as it was.
    """
    target = Path(path)
    partial = target.with_name(f"{target.name}.{os.getpid()}{PARTIAL}")
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(target)
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
    descriptor = os.open(target.parent, os.O_RDONLY)
    try:
        os.fsync(descriptor)  # the name survives a power cut as well
    finally:
        os.close(descriptor)


def npz(arrays: Mapping[str, NDArray[np.generic]]) -> bytes:
    """Return the bytes of an `.npz` file; raises ValueError if an array holds Python objects."""
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    return content.getvalue()


def read_arrays(path: str | os.PathLike[str], largest: int = LARGEST_FILE) -> Arrays:
    """Return the arrays of an `.npz` file by name, of at most `largest` bytes in memory.

    Raises:
        OSError: the file cannot be opened.
        ValueError: it is damaged, something else or too large. The message does not name the file.
    """
    refuse_special(path)
    with Path(path).open("rb") as file:
        try:
            with zipfile.ZipFile(file) as members:
                found = _members(members, largest)
                return {name: _array(members, one) for name, one in found.items()}
        except _UNREADABLE as error:
            raise ValueError(f"it is no .npz file of plain arrays, or damaged ({error})") from error


def refuse_special(path: str | os.PathLike[str]) -> None:
    """Raise ValueError for a pipe or a device: reading it may wait for ever, or never end."""
    with contextlib.suppress(FileNotFoundError):
        mode = Path(path).stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise ValueError("it is a pipe or a device, but only files are read")


def parse_json(text: str | bytes) -> Any:
    """Return what a JSON text says; raises ValueError if it is no JSON, or nested too deeply."""
    too_deep = "it is nested too deeply"
    try:
        document = json.loads(text)
    except RecursionError as error:
        raise ValueError(too_deep) from error
    inner = [document]
    for _ in range(DEEPEST):
        inner = [
            value
            for one in inner
            if isinstance(one, dict | list)
            for value in (one.values() if isinstance(one, dict) else one)
        ]
    if inner:  # what walks through it later would fail
        raise ValueError(too_deep)
    return document


def write_archive(
    path: str | os.PathLike[str],
    arrays: Mapping[str, NDArray[np.generic]],
    metadata: Mapping[str, Any],
) -> None:
    """Write the file of a policy or of an explorer; see `write_whole`. `metadata` is for JSON."""
    text = json.dumps({**_HEAD, **metadata})
    write_whole(path, npz({_METADATA: np.array(text), **arrays}))


def read_archive(path: str | os.PathLike[str]) -> tuple[Arrays, dict[str, Any]]:
    """Return the arrays and the metadata of a file that `write_archive` wrote.

    Raises:
        OSError: the file cannot be opened.
        ValueError: it is damaged, something else, or of a version that this one cannot read.
    """
    try:
        arrays = read_arrays(path)
        metadata = parse_json(str(arrays.pop(_METADATA)))
    except (KeyError, ValueError) as error:
        raise ValueError(
            "it must be a file written by `maesn export` or `Explorer.save`, but it is "
            f"something else or damaged ({error}); write it again"
        ) from error
    _check_version(metadata)
    return arrays, {name: value for name, value in metadata.items() if name not in _HEAD}


def _members(archive: zipfile.ZipFile, largest: int) -> dict[str, zipfile.ZipInfo]:
    """Return what is in a file by the names of the arrays, if it states no more than is read."""
    members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
    if {member.compress_type for member in members.values()} - _COMPRESSIONS:
        raise ValueError("it is compressed in another way than `numpy.savez_compressed` does")
    size = sum(member.file_size for member in members.values())
    if size > largest:
        raise ValueError(f"it states {size / 1e6:,.0f} MB of arrays, at most {largest / 1e6:,.0f}")
    return members


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[np.generic]:
    content = archive.read(member)  # compares the checksum before NumPy interprets anything
    if not content.startswith(np.lib.format.MAGIC_PREFIX):
        raise ValueError(f"`{member.filename.removesuffix('.npy')}` is no array")
    return np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)


def _check_version(metadata: Any) -> None:
    found = metadata if isinstance(metadata, dict) else {}
    if found.get("format") != FORMAT:
        raise ValueError(f"its format must be {FORMAT!r}, got {found.get('format')!r}.")
    if found.get("version") != VERSION:
        raise ValueError(
            f"its version must be {VERSION}, got {found.get('version')!r}: read it with the "
            "release of maesn that wrote it, or export the run again with this one."
        )
