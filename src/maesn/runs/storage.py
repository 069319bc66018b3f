"""Files of a run: written whole or not at all, and whatever fails is told in one sentence."""

import contextlib
import errno
import fcntl
import json
import logging
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

logger = logging.getLogger(__name__)

# A file of this suffix was being written when its process died; nothing reads it.
PARTIAL = ".partial"
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
    errno.EEXIST: "there is a file in its place: choose another directory",
    errno.ENOENT: "check the spelling",
}


class RunError(Exception):
    """A run cannot be made, read or continued; the message is a sentence for the user."""


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
    partial = path.with_name(path.name + PARTIAL)
    with explained("write", path):
        try:
            with partial.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            partial.replace(path)
        finally:
            with contextlib.suppress(OSError):
                partial.unlink(missing_ok=True)
        sync_directory(path.parent)


def sync_directory(directory: Path) -> None:
    """Make the names in a directory survive a power cut."""
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


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


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON document.

    Raises:
        RunError: the file is missing, unreadable, or not a JSON object.
    """
    with explained("read", path):
        content = path.read_bytes()
    try:
        document = json.loads(content)
    except ValueError as error:
        raise RunError(f"`{path}` must hold a JSON document, but: {error}.") from error
    if not isinstance(document, dict):
        raise RunError(f"`{path}` must hold a JSON object, got {type(document).__name__}.")
    return document


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
