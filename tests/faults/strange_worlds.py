"""Gymnasium environments that are at fault, each in one way.

Worker processes import this file, so it imports no JAX.
"""

import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

STEPS = 4
DUE = 2
"""The step at which it happens."""


class Sound(gymnasium.Env[Any, Any]):
    """A point that moves by its action."""

    metadata = {"render_modes": [], "render_fps": 10}  # noqa: RUF012  # Gymnasium's own form
    observation_space: Any = spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space: Any = spaces.Box(-1, 1, (2,), np.float32)

    def __init__(self) -> None:
        self.place, self.steps = np.zeros(2, np.float32), 0

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.place, self.steps = self.np_random.standard_normal(2).astype(np.float32), 0
        return self.place, {}

    def step(self, action: Any) -> Any:
        self.steps += 1
        self.place = (self.place + action).astype(np.float32)
        return self.place, float(-abs(self.place).sum()), False, False, {}


def _at_step(change: Callable[[tuple[Any, ...]], Any]) -> type[Sound]:
    class Faulty(Sound):
        def step(self, action: Any) -> Any:
            answer = super().step(action)
            return change(answer) if self.steps == DUE else answer

    return Faulty


def _at_reset(change: Callable[[Any], Any]) -> type[Sound]:
    class Faulty(Sound):
        def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
            return change(super().reset(seed=seed))

    return Faulty


def _spaces(observation: Any = Sound.observation_space, action: Any = Sound.action_space) -> Any:
    class Faulty(Sound):
        observation_space, action_space = observation, action

    return Faulty


def _raise(error: BaseException) -> Any:
    raise error


def _deep(depth: int) -> Any:
    return _deep(depth + 1)


class Unspeakable(Exception):
    """Its text cannot be made."""

    def __str__(self) -> str:
        raise ValueError("no words")


class Wordless:
    """Cannot be shown."""

    def __repr__(self) -> str:
        raise ValueError("no words")


def _replaced(index: int, value: Any) -> type[Sound]:
    return _at_step(lambda answer: (*answer[:index], value, *answer[index + 1 :]))


def _print(answer: Any) -> Any:
    print("x" * 100_000)
    print("x" * 100_000, file=sys.stderr)
    os.write(1, b"\x80\x04K\x01.")
    return answer


def _close(answer: Any) -> Any:
    os.closerange(3, 64)
    return answer


def _threads(answer: Any) -> Any:
    threading.Thread(target=time.sleep, args=(3600,)).start()
    return answer


def _warn(answer: Any) -> Any:
    warnings.warn("take care", stacklevel=2)
    return answer


class Unclosable(Sound):
    def close(self) -> None:
        raise OSError("the door is stuck")


# What it is called -> what makes it.
WORLDS: dict[str, Callable[[], Any]] = {
    "observation: three numbers": _replaced(0, np.zeros(3, np.float32)),
    "observation: NaN": _replaced(0, np.float32([0, np.nan])),
    "observation: infinite": _replaced(0, np.float32([np.inf, 0])),
    "observation: beyond single precision": _replaced(0, np.array([1e300, 0])),
    "observation: None": _replaced(0, None),
    "observation: text": _replaced(0, "here"),
    "observation: ragged": _replaced(0, [[1], [1, 2]]),
    "observation: complex": _replaced(0, np.array([1j, 0])),
    "observation: cannot be shown": _replaced(0, Wordless()),
    "observation: huge": _replaced(0, np.zeros(10**7, np.float32)),
    "reward: NaN": _replaced(1, np.nan),
    "reward: None": _replaced(1, None),
    "reward: two": _replaced(1, np.zeros(2)),
    "reward: a number of 400 digits": _replaced(1, 10**400),
    "reward: a huge text": _replaced(1, "x" * 10**7),
    "terminated: text": _replaced(2, "no"),
    "terminated: None": _replaced(2, None),
    "truncated: two": _replaced(3, np.array([True, False])),
    "info: None": _replaced(4, None),
    "info: success is a text": _replaced(4, {"success": "no"}),
    "step: four values": _at_step(lambda answer: answer[:4]),
    "step: None": _at_step(lambda _: None),
    "step: raises": _at_step(lambda _: _raise(ValueError("stuck"))),
    "step: raises ten million characters": _at_step(lambda _: _raise(ValueError("!" * 10**7))),
    "step: raises what has no text": _at_step(lambda _: _raise(Unspeakable())),
    "step: raises what cannot be pickled": _at_step(lambda _: _raise(ValueError(threading.Lock()))),
    "step: recurses": _at_step(lambda _: _deep(0)),
    "step: out of memory": _at_step(lambda _: _raise(MemoryError())),
    "step: interrupts": _at_step(lambda _: _raise(KeyboardInterrupt())),
    "step: quits": _at_step(lambda _: sys.exit(4)),
    "step: ends its process": _at_step(lambda _: os._exit(3)),
    "step: is killed": _at_step(lambda _: os.kill(os.getpid(), signal.SIGKILL)),
    "step: hangs": _at_step(lambda _: time.sleep(3600)),
    "step: stops itself": _at_step(lambda _: os.kill(os.getpid(), signal.SIGSTOP)),
    "step: prints": _at_step(_print),
    "step: closes files that are not its own": _at_step(_close),
    "step: leaves a thread": _at_step(_threads),
    "step: warns": _at_step(_warn),
    "reset: raises": _at_reset(lambda _: _raise(OSError("no power"))),
    "reset: three values": _at_reset(lambda answer: (*answer, 0)),
    "reset: another shape": _at_reset(lambda _: (np.zeros(5, np.float32), {})),
    "spaces: none": gymnasium.Env,
    "spaces: actions without bounds": _spaces(action=spaces.Box(-np.inf, np.inf, (2,))),
    "spaces: no actions": _spaces(action=spaces.Box(-1, 1, (0,))),
    "spaces: several choices": _spaces(action=spaces.MultiDiscrete([2, 3])),
    "spaces: observations of text": _spaces(spaces.Text(5)),
    "spaces: observations without end": _spaces(spaces.Sequence(spaces.Discrete(3))),
    "spaces: None": _spaces(None, None),
    "made: not at all": lambda: _raise(OSError("no licence")),
    "made: None": lambda: None,
    "made: ends its process": lambda: os._exit(5),
    "close: raises": Unclosable,
}


def make(name: str, task: Any, reward: str) -> Any:
    """Make the environment of a name; the third task alone is at fault."""
    return WORLDS[name]() if int(task[0]) == 2 else Sound()


def make_all(name: str, task: Any, reward: str) -> Any:
    """Make it for every task."""
    return WORLDS[name]()


def draw_tasks(stream: np.random.Generator, size: int) -> np.ndarray:
    return np.arange(size, dtype=np.float32)[:, None]
