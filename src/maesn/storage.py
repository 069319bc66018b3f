"""Files: written whole or not at all, read without executing anything.

Whatever goes wrong here, such as a full disk or damaged content, is a `RunError`.
"""

import contextlib
import errno
import fcntl
import json
import logging
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from maesn.runtime import archive

logger = logging.getLogger(__name__)

# Stands in a directory that is being filled. Where it has stayed, its process died over that.
UNFINISHED = ".unfinished"

_ADVICE = {
    errno.ENOSPC: "free some space there, or choose another directory",
    errno.EDQUOT: "free some space there, or choose another directory",
    errno.EFBIG: "free some space there, or raise the limit on the size of files",
    errno.EACCES: "ask for the permission, or choose another directory",
    errno.EPERM: "ask for the permission, or choose another directory",
    errno.EROFS: "choose a directory that can be written to",
    errno.ENOTDIR: "a part of this path is a file: choose another directory",
    errno.EEXIST: "a file has that name: choose another directory",
    errno.ENOENT: "check the spelling",
}


class RunError(Exception):
    """What was asked for cannot be done; the message is a sentence that says what to do."""


@contextlib.contextmanager
def explained(action: str, path: Path) -> Iterator[None]:
    """Turn an error of the operating system into a `RunError`: "cannot <action> `path`..."."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        advice = _ADVICE.get(error.errno or 0, "look at the file system, then try again")
        raise RunError(f"cannot {action} `{path}` ({reason}): {advice}.") from error


@contextlib.contextmanager
def refusals(before: str = "") -> Iterator[None]:
    """Turn a `ValueError`, by which code refuses a setting, into a `RunError`."""
    try:
        yield
    except ValueError as error:
        raise RunError(f"{before}{error}") from error


@contextlib.contextmanager
def new_directory(directory: Path) -> Iterator[None]:
    """Make a directory, new or empty, for the block to fill; remove it again if the block fails.

    What a process left behind that was killed over the same is cleared.
    """
    with explained("make", directory):
        if (directory / UNFINISHED).exists():
            shutil.rmtree(directory)
        directory.mkdir(parents=True, exist_ok=True)
        occupied = any(directory.iterdir())
    if occupied:
        raise RunError(
            f"`{directory}` must be a new or an empty directory, but holds files: choose another "
            f"one, or go on with the run in it (maesn resume {directory})."
        )
    try:
        with explained("fill", directory):
            (directory / UNFINISHED).touch()
            yield
            (directory / UNFINISHED).unlink()
    except BaseException:
        shutil.rmtree(directory, ignore_errors=True)
        raise


def write_whole(path: Path, content: bytes) -> None:
    """Write a file and the directories above; at any moment it is the old one or the new one."""
    with explained("write", path):
        path.parent.mkdir(parents=True, exist_ok=True)
        archive.write_whole(path, content)


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a JSON document of finite numbers for people to read; see `write_whole`."""
    with refusals(f"`{path}` must hold finite numbers, but: "):
        text = json.dumps(document, indent=2, allow_nan=False)
    write_whole(path, (text + "\n").encode())


def read_json(path: Path, remedy: str = "restore it") -> dict[str, Any]:
    """Read a JSON object. Messages of errors end with the remedy."""
    with _expecting("a JSON object", path, remedy):
        archive.refuse_special(path)
        return _parsed(path.read_bytes())


def read_json_lines(path: Path, remedy: str = "restore it") -> list[dict[str, Any]]:
    """Read a file with one JSON object per line.

    A last line without its line break is left out: it may be being written at this moment.
    """
    with _expecting("lines of JSON objects", path, remedy):
        archive.refuse_special(path)
        complete, _, _ = path.read_bytes().rpartition(b"\n")
        lines = enumerate(complete.splitlines(), start=1)
        return [_parsed(line, f"line {number}") for number, line in lines]


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write an `.npz` file of plain arrays, and the directories above it."""
    with explained("write", path):
        path.parent.mkdir(parents=True, exist_ok=True)
        archive.write_arrays(path, {name: np.asarray(x) for name, x in arrays.items()})


def read_arrays(
    path: Path, remedy: str, largest: int = archive.LARGEST_FILE
) -> dict[str, np.ndarray]:
    """Read the arrays of an `.npz` file by name, of `largest` bytes at most; no pickled objects."""
    with _expecting("arrays", path, remedy):
        return archive.read_arrays(path, largest=largest)


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Let no other process enter a block with the same file, until this one ends in any way."""
    with contextlib.ExitStack() as stack:
        with explained("open", path):
            file = stack.enter_context(path.open("r+b"))
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise RunError(
                f"another process is at work in `{path.parent}`: wait for it, or stop it."
            ) from error
        except OSError:
            warning = "The file system of `%s` has no locks: let no other process work in it."
            logger.warning(warning, path.parent)
        yield


@contextlib.contextmanager
def _expecting(content: str, path: Path, remedy: str) -> Iterator[None]:
    """Turn whatever goes wrong while a file is read into a `RunError`."""
    try:
        yield
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None)
        got = reason.lower() if reason else f"something else that cannot be read ({error})"
        raise RunError(f"Expected {content} at `{path}`, got {got}; {remedy}.") from error


def _parsed(text: bytes, what: str = "it") -> dict[str, Any]:
    with contextlib.suppress(ValueError):
        document = archive.parse_json(text)
        if isinstance(document, dict):
            return document
    raise ValueError(f"{what} is no JSON object")
