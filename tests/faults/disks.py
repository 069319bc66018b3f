"""Disks that are full, read-only or failing."""

import errno
import os
import random
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

from faults.kills import LARGEST
from faults.material import Material
from faults.processes import Ended, failing_at, fork, on_a_full_disk, wait
from faults.scenarios import SCENARIOS, operations
from faults.table import CLEAR, CONTINUED, LOSS, TRACEBACK, Findings

from maesn.storage import RunError

REASONS = (errno.ENOSPC, errno.EROFS, errno.EIO, errno.EDQUOT, errno.EACCES)
REFUSED = 3
PAGE = 4096


def attempt(stream: random.Random, material: Material, directory: Path, findings: Findings) -> None:
    """Let one operation fail, or all that write; then go on, on a sound disk."""
    name = stream.choice(list(SCENARIOS))
    kinds = [_one_operation, _no_larger_files]
    kinds += [_full_file_system, _read_only_file_system] if _can_mount(material.directory) else []
    with stream.choice(kinds)(stream, name, material, directory) as (ended, how):
        what = f"{name}, {how}"
        if ended.status not in (0, REFUSED):
            findings.add(TRACEBACK, f"{what}: status {ended.status}, {ended.said}")
            return
        lost = SCENARIOS[name].lost(material, directory)
        outcome = CLEAR if ended.status == REFUSED else CONTINUED
        findings.add(LOSS if lost else outcome, f"{what}: {lost} ({ended.said})")


@contextmanager
def _one_operation(
    stream: random.Random, name: str, material: Material, directory: Path
) -> Iterator[tuple[Ended, str]]:
    moment, reason = stream.randrange(operations(name, material)), stream.choice(REASONS)
    SCENARIOS[name].prepare(material, directory)
    work = failing_at(partial(SCENARIOS[name].work, material, directory), moment, reason)
    yield _ended(work, material), f"{errno.errorcode[reason]} at operation {moment}"


@contextmanager
def _no_larger_files(
    stream: random.Random, name: str, material: Material, directory: Path
) -> Iterator[tuple[Ended, str]]:
    size = stream.randrange(LARGEST)
    SCENARIOS[name].prepare(material, directory)
    work = on_a_full_disk(partial(SCENARIOS[name].work, material, directory), size)
    yield _ended(work, material), f"EFBIG at {size} bytes"


@contextmanager
def _full_file_system(
    stream: random.Random, name: str, material: Material, directory: Path
) -> Iterator[tuple[Ended, str]]:
    pages = stream.randrange(1, 9)
    with _mounted(directory):
        SCENARIOS[name].prepare(material, directory)
        found = os.statvfs(directory)
        used = (found.f_blocks - found.f_bfree) * found.f_frsize
        _mount(directory, f"remount,size={used + pages * PAGE}")
        ended = _ended(partial(SCENARIOS[name].work, material, directory), material)
        _mount(directory, "remount,size=64m")
        yield ended, f"a file system with {pages} pages left"


@contextmanager
def _read_only_file_system(
    stream: random.Random, name: str, material: Material, directory: Path
) -> Iterator[tuple[Ended, str]]:
    with _mounted(directory):
        SCENARIOS[name].prepare(material, directory)
        _mount(directory, "remount,ro")
        ended = _ended(partial(SCENARIOS[name].work, material, directory), material)
        _mount(directory, "remount,rw")
        yield ended, "a read-only file system"


def _ended(work: Any, material: Material) -> Ended:
    said = material.directory / "said"
    said.unlink(missing_ok=True)
    return wait(fork(partial(refusing, work), said), said)


def refusing(work: Any) -> None:
    """Do the work; end with a sentence and an exit status where it cannot be done."""
    try:
        work()
    except (RunError, OSError) as error:  # the runtime documents the second
        print(error)
        raise SystemExit(REFUSED) from error


@contextmanager
def _mounted(directory: Path) -> Iterator[None]:
    _mount(directory, "size=64m", "-t", "tmpfs", "tmpfs")
    try:
        yield
    finally:
        subprocess.run(["umount", directory], check=True)


def _mount(directory: Path, options: str, *more: str) -> None:
    words = ["mount", "-o", options, *more, directory]
    subprocess.run(words, check=True, capture_output=True)


@cache
def _can_mount(directory: Path) -> bool:
    """Whether this machine lets this process make file systems of its own."""
    with suppress(OSError, subprocess.CalledProcessError), _mounted(directory):
        return True
    return False
