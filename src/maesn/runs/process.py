"""Process-wide settings: the cache of compiled programs, and an orderly end on signals."""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax


def enable_compilation_cache() -> None:
    """Keep compiled programs on disk, so that the next process starts at once.

    JAX's own variables choose another directory (`JAX_COMPILATION_CACHE_DIR`), or keep nothing
    (`JAX_ENABLE_COMPILATION_CACHE=false`).
    """
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    settings = {
        "jax_compilation_cache_dir": os.environ.get("JAX_COMPILATION_CACHE_DIR", f"{home}/maesn"),
        # Most programs of the first iteration compile in less than the second of JAX's default.
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": 0,
    }
    for name, value in settings.items():
        jax.config.update(name, value)  # type: ignore[no-untyped-call]


@contextlib.contextmanager
def ending_by_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP leave the block by `SystemExit`, with the status that shells report.

    A second signal ends the process at once. A handler that the program has already stays, and so
    does a signal that is ignored.
    """
    handled = []
    if threading.current_thread() is threading.main_thread():  # elsewhere they cannot be handled
        numbers = (signal.SIGTERM, signal.SIGHUP)
        handled = [number for number in numbers if signal.getsignal(number) == signal.SIG_DFL]

    def end(number: int, _: Any) -> None:
        for one in (*handled, signal.SIGINT):
            signal.signal(one, signal.SIG_DFL)
        raise SystemExit(128 + number)

    for number in handled:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, signal.SIG_DFL)
