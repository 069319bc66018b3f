"""Files: written whole or not at all, read without executing anything.

What a user can mend is a `RunError`, whose message says in one sentence what to do.
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
    """Turn errors of the operating system into a `RunError`.

    Args:
        action: what is being done, as in "cannot <action> `path`".
        path: to what.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        advice = _ADVICE.get(error.errno or 0, "look at the file system, then try again")
        raise RunError(f"cannot {action} `{path}` ({reason}): {advice}.") from error


@contextlib.contextmanager
def refusals(before: str = "") -> Iterator[None]:
    """Turn a `ValueError`, by which code refuses a setting, into a `RunError`.

    Args:
        before: what the message begins with.
    """
    try:
        yield
    except ValueError as error:
        raise RunError(f"{before}{error}") from error


@contextlib.contextmanager
def new_directory(directory: Path) -> Iterator[None]:
    """Make a directory for the block to fill, and remove it again if the block fails.

    What a process left behind that was killed over the same is cleared away.

    Raises:
        RunError: it is in use or cannot be made.
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
    """Write a file so that at any moment, power cuts included, it is the old one or the new one.

    Raises:
        RunError: the operating system refuses, for example because the disk is full.
    """
    with explained("write", path):
        archive.write_whole(path, content)


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a JSON document for people to read; see `write_whole`.

    Raises:
        RunError: the file cannot be written, or a number is not finite.
    """
    try:
        text = json.dumps(document, indent=2, allow_nan=False)
    except ValueError as error:
        raise RunError(f"`{path}` must hold finite numbers, but: {error}.") from error
    write_whole(path, (text + "\n").encode())


def read_json(path: Path, remedy: str = "restore it") -> dict[str, Any]:
    """Read a JSON object.

    Args:
        path: of the file.
        remedy: what the user should do if it is missing or damaged.

    Raises:
        RunError: the file is missing, unreadable, or no JSON object.
    """
    try:
        document = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise RunError(f"Expected a JSON file at `{path}`, got {_why(error)}; {remedy}.") from error
    return _object(document, f"`{path}`", remedy)


def read_json_lines(path: Path, remedy: str = "restore it") -> list[dict[str, Any]]:
    """Read a file with one JSON object per line.

    A last line without its line break is left out: it may be being written at this moment.

    Args:
        path: of the file.
        remedy: what the user should do if it is missing or damaged.

    Raises:
        RunError: the file is unreadable, or a line is no JSON object.
    """
    try:
        complete, _, _ = path.read_text(encoding="utf-8").rpartition("\n")
    except (OSError, ValueError) as error:
        raise RunError(f"Expected metrics at `{path}`, got {_why(error)}; {remedy}.") from error
    lines = enumerate(complete.splitlines(), start=1)
    return [_line(line, f"`{path}`, line {i}", remedy) for i, line in lines if line.strip()]


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write an `.npz` file of plain arrays, and the directories above it.

    Raises:
        RunError: the file cannot be written.
    """
    with explained("write", path):
        path.parent.mkdir(parents=True, exist_ok=True)
        archive.write_arrays(path, {name: np.asarray(x) for name, x in arrays.items()})


def read_arrays(path: Path, remedy: str) -> dict[str, np.ndarray]:
    """Read the arrays of an `.npz` file by name. Pickled objects are refused.

    Args:
        path: of the file.
        remedy: what the user should do if it is missing or damaged.

    Raises:
        RunError: the file is unreadable, or holds something else than arrays.
    """
    try:
        return archive.read_arrays(path)
    except (OSError, ValueError) as error:
        raise RunError(f"Expected arrays at `{path}`, got {_why(error)}; {remedy}.") from error


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Let no other process enter a block with the same file.

    The operating system takes the lock back when the process ends, however it ends.

    Raises:
        RunError: another process is in the block.
    """
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
            logger.warning(
                "The file system of `%s` has no locks: make sure that no other process is at "
                "work in it.",
                path.parent,
            )
        yield


def _line(line: str, where: str, remedy: str) -> dict[str, Any]:
    try:
        document = json.loads(line)
    except ValueError as error:
        raise RunError(
            f"Expected a JSON object in {where}, got {line[:40]!r}; {remedy}."
        ) from error
    return _object(document, where, remedy)


def _object(document: Any, where: str, remedy: str) -> dict[str, Any]:
    if not isinstance(document, dict):
        raise RunError(f"Expected an object in {where}, got {type(document).__name__}; {remedy}.")
    return document


def _why(error: Exception) -> str:
    if isinstance(error, FileNotFoundError):
        return "no such file"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror.lower()
    return f"something else that cannot be read ({error})"
