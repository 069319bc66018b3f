"""Files: written whole or not at all, read without executing anything.

Whatever goes wrong here, such as a full disk or damaged content, is a `RunError`.
"""

import contextlib
import csv
import errno
import fcntl
import glob
import gzip
import io
import json
import logging
import os
import platform
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maesn.runtime import archive

logger = logging.getLogger(__name__)

# Stands in a directory while a process works in it, which it names. It stays if that is killed.
LOCK = ".maesn-lock"

_ADVICE = {
    errno.ENOSPC: "free some space there, or choose another directory",
    errno.EDQUOT: "free some space there, or choose another directory",
    errno.EFBIG: "free some space there, or raise the limit on the size of files",
    errno.EACCES: "ask for the permission, or choose another directory",
    errno.EPERM: "ask for the permission, or choose another directory",
    errno.EROFS: "choose a directory that can be written to",
    errno.ENOTDIR: "a part of this path is a file: choose another directory",
    errno.EISDIR: "name a file in it",
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
def new_directory(directory: Path, files: Sequence[str]) -> Iterator[None]:
    """Make a directory, new or empty, for the block to fill; undo that if the block fails.

    `files` are the paths in it that the block may write; the last one makes it whole. Nothing else
    is removed. What a process has left here that was killed over the same is written again. Other
    files in it, or another process at work in it, are a `RunError`.
    """
    existed = directory.exists()
    try:
        with explained("make", directory):
            directory.mkdir(parents=True, exist_ok=True)
            if not (directory / LOCK).exists():
                _check_vacant(directory, [])
        with locked(directory), explained("fill", directory):
            _check_vacant(directory, [LOCK, *files[:-1]])
            try:
                yield
            except BaseException:
                for path in [directory / name for name in files]:
                    path.unlink(missing_ok=True)
                    if path.parent != directory:
                        with contextlib.suppress(OSError):  # it is not empty
                            path.parent.rmdir()
                raise
    finally:
        if not existed:
            with contextlib.suppress(OSError):  # it is not empty
                directory.rmdir()


def _check_vacant(directory: Path, expected: Sequence[str]) -> None:
    """Refuse a directory that holds more than a process can have left that died over filling it."""
    own = {directory / name for name in expected}
    own |= {path.parent for path in own}
    for path in directory.rglob("*"):
        if path not in own and not (own and path.suffix == archive.PARTIAL):
            raise RunError(
                f"`{directory}` must be a new or an empty directory, but holds files: choose "
                f"another one, or go on with the run in it (maesn resume {directory})."
            )


def discard_partial(directory: Path, name: str = "*", seconds: float = 0.0) -> None:
    """Remove what killed processes were writing, of this name and not touched for so long."""
    for path in directory.glob(f"{name}.[0-9]*{archive.PARTIAL}"):
        with contextlib.suppress(OSError):  # a file too many does no harm
            if time.time() - path.stat().st_mtime >= seconds:
                path.unlink()


def check_writable(path: Path) -> None:
    """Refuse a path to which no file can be written, before the work that the file is for."""
    with explained("write", path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "Is a directory")
        with tempfile.TemporaryFile(dir=path.parent) as probe:
            probe.write(bytes(65536))  # a full disk may still have room for a name


def refuse_links(directory: Path) -> None:
    """Refuse a directory that holds links, pipes and the like: writing would go somewhere else."""
    for path in (*directory.glob("*"), *directory.glob("*/*")):
        if path.is_symlink() or not (path.is_file() or path.is_dir()):
            raise RunError(
                f"`{path}` must be a file or a folder itself, but is a link or the like: remove "
                "it, or put what it points to in its place."
            )


def write_whole(path: Path, content: bytes) -> None:
    """Write a file and the directories above; at any moment it is the old one or the new one."""
    with explained("write", path):
        path.parent.mkdir(parents=True, exist_ok=True)
        discard_partial(path.parent, glob.escape(path.name), 3600.0)  # no writer takes an hour
        archive.write_whole(path, content)


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a JSON document of finite numbers for people to read; see `write_whole`."""
    with refusals(f"`{path}` must hold finite numbers, but: "):
        text = json.dumps(document, indent=2, allow_nan=False)
    write_whole(path, (text + "\n").encode())


def write_rows(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write rows of the same columns, at least one, as `.csv` or `.csv.gz`; see `write_whole`."""
    first, *others = rows
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(first), lineterminator="\n")
    writer.writeheader()
    writer.writerows([first, *others])
    content = text.getvalue().encode()
    # Without the time, so that equal rows are equal bytes.
    write_whole(path, gzip.compress(content, mtime=0) if path.suffix == ".gz" else content)


def read_json(path: Path, remedy: str = "restore it") -> dict[str, Any]:
    """Read a JSON object. Messages of errors end with the remedy."""
    with _expecting("a JSON object", path, remedy):
        return _parsed(path.read_bytes())


def read_json_lines(path: Path, remedy: str = "restore it") -> list[dict[str, Any]]:
    """Read a file with one JSON object per line.

    A last line without its line break is left out: it may be being written at this moment.
    """
    with _expecting("lines of JSON objects", path, remedy):
        lines = path.read_bytes().split(b"\n")[:-1]
        return [_parsed(line, f"line {number}") for number, line in enumerate(lines, start=1)]


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
def locked(directory: Path) -> Iterator[None]:
    """Let no other process work in a directory, until the block or this process ends in any way.

    If another one does, or there are links in it, that is a `RunError`.
    """
    path, owner, mine = directory / LOCK, b"", False
    refuse_links(directory)
    with explained("open", path):
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    with os.fdopen(descriptor, "r+b", buffering=0) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Its last owner may just have removed it.
            mine = os.path.samestat(path.stat(), os.fstat(descriptor))
        except (BlockingIOError, FileNotFoundError):
            owner = file.read(200)
        except OSError:
            mine = True
            warning = "The file system of `%s` has no locks: let no other process work in it."
            logger.warning(warning, directory)
        if not mine:
            raise RunError(
                f"{owner.decode(errors='replace') or 'another process'} is at work in "
                f"`{directory}`: wait for it, stop it, or choose another directory."
            )
        with contextlib.suppress(OSError):  # a lock that names nobody is one as well
            file.truncate()
            file.write(f"process {os.getpid()} on {platform.node()}".encode())
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                path.unlink()


@contextlib.contextmanager
def _expecting(content: str, path: Path, remedy: str) -> Iterator[None]:
    """Turn whatever goes wrong while a file is read into a `RunError`."""
    try:
        archive.refuse_special(path)
        yield
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None)
        got = reason.lower() if reason else f"something else that cannot be read ({error})"
        raise RunError(f"Expected {content} at `{path}`, got {got}; {remedy}.") from error


def _parsed(text: bytes, what: str = "it") -> dict[str, Any]:
    with contextlib.suppress(ValueError):
        if isinstance(document := archive.parse_json(text), dict):
            return document
    raise ValueError(f"{what} is no JSON object")
