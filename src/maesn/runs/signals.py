"""Signals by which schedulers, containers and closing terminals end a program."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from typing import Any


@contextlib.contextmanager
def ending_by_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP leave the block by `SystemExit`, with the status that shells report.

    A second signal ends the process at once. A handler that the program has already stays, and so
    does a signal that is ignored.
    """
    # Elsewhere than in the main thread signals cannot be handled.
    is_main = threading.current_thread() is threading.main_thread()
    numbers = (signal.SIGTERM, signal.SIGHUP) if is_main else ()
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
