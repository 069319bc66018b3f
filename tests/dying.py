"""A process that dies at any of its file operations, played in this process."""

import os
from collections.abc import Callable
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

    def at_files(self, patch: pytest.MonkeyPatch) -> None:
        """Count what `maesn.storage` does to files."""
        patch.setattr(os, "fsync", self.before(os.fsync))
        patch.setattr(Path, "replace", self.before(Path.replace))
        # Also the clean-up after an exception, which a dead process does not do.
        for name in ("unlink", "mkdir", "rmdir"):
            patch.setattr(Path, name, self.before(getattr(Path, name)))
