"""Processes that die at any of their file operations, and disks that are full."""

import os
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest


class Crash(BaseException):
    """The process is gone."""


class Death:
    """Lets a process die at its n-th write: that one is half done, and nothing follows."""

    def __init__(self, moment: int) -> None:
        self._left = moment
        self.dead = False

    def before(self, call: Callable[..., Any], half: Callable[..., Any] | None = None) -> Any:
        def wrapped(*arguments: Any, **options: Any) -> Any:
            if not self.dead and self._left > 0:
                self._left -= 1
                return call(*arguments, **options)
            if half is not None and not self.dead:
                half(*arguments)
            self.dead = True
            raise Crash

        return wrapped

    def at_files(self, patch: pytest.MonkeyPatch, *others: str) -> None:
        """Count what is done to files, by these methods of paths as well."""
        patch.setattr(os, "fsync", self.before(os.fsync))
        patch.setattr(Path, "replace", self.before(Path.replace))
        # Removing is also the clean-up after an exception, which a dead process does not do.
        for name in ("unlink", *others):
            patch.setattr(Path, name, self.before(getattr(Path, name)))


@contextmanager
def files_no_larger_than(size: int) -> Iterator[None]:
    """Let writes fail as they do on a full disk, some of them half done."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
