"""Gymnasium environments that are at fault in ways that few authors think of.

`strangers` has the others. Worker processes import this file, so it imports no JAX.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from strangers import Settable

DUE = 2
"""The step at which it happens."""


class Unspeakable(Exception):
    """Its text cannot be made."""

    def __str__(self) -> str:
        raise ValueError("no words")


class Wordless:
    """Cannot be shown."""

    def __repr__(self) -> str:
        raise ValueError("no words")


def _raise(error: BaseException) -> Any:
    raise error


def _recurse(depth: int = 0) -> Any:
    return _recurse(depth + 1)


def _print() -> None:
    print("x" * 100_000)
    print("x" * 100_000, file=sys.stderr)
    os.write(1, b"\x80\x04K\x01.")


FAULTS: dict[str, Callable[[], Any]] = {
    "raises ten million characters": lambda: _raise(ValueError("!" * 10**7)),
    "raises what has no text": lambda: _raise(Unspeakable()),
    "raises what cannot be pickled": lambda: _raise(ValueError(threading.Lock())),
    "recurses": _recurse,
    "is out of memory": lambda: _raise(MemoryError()),
    "interrupts": lambda: _raise(KeyboardInterrupt()),
    "quits": lambda: sys.exit(4),
    "is killed": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "stops itself": lambda: os.kill(os.getpid(), signal.SIGSTOP),
    "prints": _print,
    "closes files that are not its own": lambda: os.closerange(3, 64),
    "leaves a thread": lambda: threading.Thread(target=time.sleep, args=(3600,)).start(),
}
"""What an environment does in a step."""
ANSWERS: dict[str, Callable[[tuple[Any, ...]], Any]] = {
    "observes a text": lambda answer: ("here", *answer[1:]),
    "observes what cannot be shown": lambda answer: (Wordless(), *answer[1:]),
    "observes ten million numbers": lambda answer: (np.zeros(10**7), *answer[1:]),
    "rewards with 400 digits": lambda answer: (answer[0], 10**400, *answer[2:]),
    "rewards with a text": lambda answer: (answer[0], "x" * 10**7, *answer[2:]),
    "returns None": lambda _: None,
}
"""What becomes of what a step returns."""
HARMLESS = {"prints", "leaves a thread"}
"""What an environment may do."""


class Strange(Settable):
    """Does in its second step what its name says, in tasks whose first number is 1."""

    def __init__(self, name: str, task: np.ndarray) -> None:
        super().__init__(task)
        self.name = name

    def step(self, action: np.ndarray) -> Any:
        answer = super().step(action)
        if self.steps != DUE or not self.task[0]:
            return answer
        if self.name in ANSWERS:
            return ANSWERS[self.name](answer)
        FAULTS[self.name]()
        return answer


def make(name: str, task: np.ndarray, reward: str) -> Strange:
    return Strange(name, task)
