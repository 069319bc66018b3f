"""Files that may be absent or wrong, or cannot be written: what came, and what to do.

Nothing here executes what it reads.
"""

import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np


class ReportError(ValueError):
    """A file cannot be drawn from. The message is one sentence for the user."""


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Name what cannot be written inside the block.

    Raises:
        ReportError: it cannot.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise ReportError(f"Cannot write `{path}` ({reason}): choose another `--out`.") from error


def read_json(path: Path, remedy: str) -> dict[str, Any]:
    """Return the object in a JSON file.

    Args:
        path: the file.
        remedy: what the user should do if it is missing or broken.

    Raises:
        ReportError: if there is no JSON object.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ReportError(
            f"Expected a JSON file at `{path}`, got {_why(error)}; {remedy}."
        ) from error
    if not isinstance(content, dict):
        raise ReportError(
            f"Expected an object in `{path}`, got {type(content).__name__}; {remedy}."
        )
    return content


def read_json_lines(path: Path, remedy: str) -> list[dict[str, Any]]:
    """Return the objects of a JSON-lines file.

    A last line without its line break is ignored: the run may be writing it at this moment.

    Raises:
        ReportError: if a complete line is not a JSON object.
    """
    try:
        complete, _, _ = path.read_text(encoding="utf-8").rpartition("\n")
    except (OSError, ValueError) as error:
        raise ReportError(f"Expected metrics at `{path}`, got {_why(error)}; {remedy}.") from error
    return [
        _json_line(line, f"`{path}`, line {number}", remedy)
        for number, line in enumerate(complete.splitlines(), start=1)
        if line.strip()
    ]


def _json_line(line: str, place: str, remedy: str) -> dict[str, Any]:
    try:
        content = json.loads(line)
    except ValueError as error:
        raise ReportError(
            f"Expected a JSON object in {place}, got {line[:40]!r}; {remedy}."
        ) from error
    if not isinstance(content, dict):
        raise ReportError(f"Expected a JSON object in {place}, got {line[:40]!r}; {remedy}.")
    return content


def read_arrays(path: Path, remedy: str) -> dict[str, np.ndarray]:
    """Return the arrays of an `.npz` file by name.

    Raises:
        ReportError: if the file cannot be read or holds pickled objects.
    """
    try:
        # A bare `.npy` array would be accepted by `np.load` as well.
        with zipfile.ZipFile(path), np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ReportError(f"Expected arrays at `{path}`, got {_why(error)}; {remedy}.") from error


def take_array(
    arrays: Mapping[str, np.ndarray], name: str, shape: Sequence[int | str], path: Path, remedy: str
) -> np.ndarray:
    """Return one array in double precision, after checking its shape.

    Args:
        arrays: as `read_arrays` returns them.
        name: which one.
        shape: a number where the size is fixed, the name of the axis where it is free.
        path: where the arrays are from, for the message.
        remedy: what the user should do if it is wrong.

    Raises:
        ReportError: if the array is absent, not numeric or of another shape.
    """
    expected = f"`{name}` [{', '.join(map(str, shape))}]"
    if name not in arrays:
        present = ", ".join(sorted(arrays)) or "no arrays"
        raise ReportError(f"Expected {expected} in `{path}`, got {present}; {remedy}.")
    array = arrays[name]
    fits = array.ndim == len(shape) and all(
        size == wanted or isinstance(wanted, str)
        for size, wanted in zip(array.shape, shape, strict=False)
    )
    if not fits or array.dtype.kind not in "fiu" or 0 in array.shape:
        got = f"{array.dtype} {list(array.shape)}"
        raise ReportError(f"Expected {expected} in `{path}`, got {got}; {remedy}.")
    return array.astype(np.float64)


def _why(error: Exception) -> str:
    if isinstance(error, FileNotFoundError):
        return "no such file"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror.lower()
    return "something else that cannot be read"
