"""Files: written whole or not at all, read without executing anything.

Whatever goes wrong here, such as a full disk or damaged content, is a `RunError`.
"""

import contextlib
import csv
import errno
import fcntl
import gzip
import io
import json
import os
import platform
import tempfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maesn.runtime import archive

# Stands in a directory while a process works in it, which it names. It stays if that is killed.
LOCK = ".maesn-lock"


class RunError(Exception):
    """What was asked for cannot be done; the message is a sentence that says what to do."""


@contextlib.contextmanager
def explained(action: str, path: Path) -> Iterator[None]:
    """Turn an error of the operating system into a `RunError`: "cannot <action> `path`..."."""
    try:
        yield
    except OSError as error:
        reason = f"({error.strerror or error}): mend that, or choose another path."
        raise RunError(f"cannot {action} `{path}` {reason}") from error


@contextlib.contextmanager
def refusals(before: str = "") -> Iterator[None]:
    """Turn a `ValueError`, which refuses a setting, into a `RunError`."""
    try:
        yield
    except ValueError as error:
        raise RunError(f"{before}{error}") from error


def check_writable(path: Path) -> None:
    """Refuse a path to which no file can be written, before the work that the file is for."""
    with explained("write", path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "Is a directory")
        with tempfile.TemporaryFile(dir=path.parent) as probe:
            probe.write(bytes(65536))  # a full disk may still have room for a name


def write_whole(path: Path, content: bytes) -> None:
    """Write a file and the directories above as a whole: a crash leaves the old one or the new."""
    with explained("write", path):
        path.parent.mkdir(parents=True, exist_ok=True)
        archive.write_whole(path, content)


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a JSON document of finite numbers for people to read; see `write_whole`."""
    with refusals(f"`{path}` must hold finite numbers: "):
        text = json.dumps(document, indent=2, allow_nan=False)
    write_whole(path, (text + "\n").encode())


def write_rows(
    path: Path, rows: Iterable[Mapping[str, Any]], columns: Sequence[str] | None = None
) -> None:
    """Write rows as `.csv` or `.csv.gz`; see `write_whole`.

    `columns` None: those of the first row, which there must be.
    """
    rows, text = list(rows), io.StringIO()
    writer = csv.DictWriter(text, fieldnames=columns or list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    content = text.getvalue().encode()
    # Without the time, so that equal rows are equal bytes.
    write_whole(path, gzip.compress(content, mtime=0) if path.suffix == ".gz" else content)


def read_rows(path: Path, remedy: str = "restore it") -> list[dict[str, Any]]:
    """Read the rows of a `.csv` or `.csv.gz` file as texts; see `read_json`."""
    opened = gzip.open if path.suffix == ".gz" else open
    with (
        _expecting("a table", path, remedy),
        opened(path, "rt", newline="", encoding="utf-8") as file,
    ):
        return list(csv.DictReader(file))


def read_json(path: Path, remedy: str = "restore it") -> dict[str, Any]:
    """Read a JSON object. Messages of errors end with the remedy."""
    with _expecting("a JSON object", path, remedy):
        return _parsed(path.read_bytes())


def read_json_lines(path: Path, remedy: str = "restore it") -> list[dict[str, Any]]:
    """Read one JSON object per line; the last line may still be written, and is then left out."""
    with _expecting("lines of JSON objects", path, remedy):
        lines = path.read_bytes().split(b"\n")[:-1]
        return [_parsed(line, f"line {number}") for number, line in enumerate(lines, start=1)]


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write an `.npz` file of plain arrays; see `write_whole`."""
    write_whole(path, archive.npz({name: np.asarray(x) for name, x in arrays.items()}))


def read_arrays(
    path: Path, remedy: str, largest: int = archive.LARGEST_FILE
) -> dict[str, np.ndarray]:
    """Read the arrays of an `.npz` file by name, of `largest` bytes at most; no pickled objects."""
    with _expecting("arrays", path, remedy):
        return archive.read_arrays(path, largest=largest)


@contextlib.contextmanager
def locked(directory: Path) -> Iterator[None]:
    """Make a directory and work in it alone; if another process does that is a `RunError`."""
    path, mine = directory / LOCK, False
    with contextlib.ExitStack() as stack:
        with explained("work in", directory):
            directory.mkdir(parents=True, exist_ok=True)
            file = stack.enter_context(path.open("a+b", buffering=0))
            with contextlib.suppress(BlockingIOError, FileNotFoundError):
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                # Its last owner may just have removed it.
                mine = os.path.samestat(path.stat(), os.fstat(file.fileno()))
            if not mine:
                file.seek(0)
                owner = file.read().decode() or "another process"
                raise RunError(f"{owner} is at work in `{directory}`: wait for it, or stop it.")
            stack.callback(path.unlink, missing_ok=True)
            file.truncate(0)
            file.write(f"process {os.getpid()} on {platform.node()}".encode())
        yield


def is_locked(directory: Path) -> bool:
    """Whether a process works in a directory. The lock of a killed process does not count."""
    with contextlib.suppress(FileNotFoundError), (directory / LOCK).open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


@contextlib.contextmanager
def _expecting(content: str, path: Path, remedy: str) -> Iterator[None]:
    """Turn whatever goes wrong while a file is read into a `RunError`."""
    try:
        archive.refuse_special(path)
        yield
    except (OSError, EOFError, ValueError, csv.Error, zlib.error) as error:
        reason = getattr(error, "strerror", None)
        got = reason.lower() if reason else f"something else that cannot be read ({error})"
        raise RunError(f"Expected {content} at `{path}`, got {got}; {remedy}.") from error


def _parsed(text: bytes, what: str = "it") -> dict[str, Any]:
    with contextlib.suppress(ValueError):
        if isinstance(document := archive.parse_json(text), dict):
            return document
    raise ValueError(f"{what} is no JSON object")
