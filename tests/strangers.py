"""Environments as users write them: well-behaved, unusual, and broken ones.

Worker processes import this file, so it imports no JAX: they start in a fraction of the time.
"""

import ctypes
import itertools
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

HORIZON = 6
START_NOISE = 0.1


class Walker(gymnasium.Env[Any, Any]):
    """A point that moves by its action in a plane; it sees the time, and where it is.

    The task is (goal x, goal y, step at which it ends, how): how 1 is terminated, 2 truncated,
    3 both, and 0 never.
    """

    metadata = {"render_modes": [], "render_fps": 10}  # noqa: RUF012  # Gymnasium's own form
    action_space = spaces.Box(np.float32([-1, 0]), np.float32([1, 0.5]))
    observation_space = spaces.Box(-np.inf, np.inf, (3,))

    def __init__(self, task: np.ndarray) -> None:
        self.task = task
        self.place = np.zeros(2)
        self.steps = 0
        self.ended = True

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.place = START_NOISE * self.np_random.standard_normal(2)
        self.steps, self.ended = 0, False
        return self.see(), {}

    def see(self) -> Any:
        return np.float32([self.steps / HORIZON, *self.place])

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert not self.ended, "stepped after its end"
        assert self.action_space.contains(action)
        self.place = self.place + action
        self.steps += 1
        distance = float(np.linalg.norm(self.place - self.task[:2]))
        due, how = self.steps == int(self.task[2]), int(self.task[3])
        self.ended = due and how > 0
        info = {"is_success": distance < 1.0}
        return self.see(), -distance, due and how in (1, 3), due and how in (2, 3), info


class Painter(Walker):
    """Paints its state: the more steps, the brighter; nothing at all in some tasks."""

    render_mode = "rgb_array"

    def render(self) -> Any:
        left = self.task[0] < 0
        return None if left else np.full((20, 10, 3), 10 * self.steps, np.uint8)


class Settable(Walker):
    """A walker that is told its next task."""

    def set_task(self, task: np.ndarray) -> None:
        self.task = task


def draw_walks(stream: np.random.Generator, size: int) -> np.ndarray:
    goals = stream.uniform(-2, 2, (size, 2))
    ends = np.stack([stream.integers(1, HORIZON, size), stream.integers(0, 4, size)], axis=1)
    return np.concatenate([goals, ends], axis=1).astype(np.float32)


class Plain(gymnasium.Env[Any, Any]):
    """Has the spaces that it is given."""

    def __init__(self, observation_space: Any, action_space: Any) -> None:
        self.observation_space, self.action_space = observation_space, action_space


class Skip(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Repeats every action, as often as it is told."""

    def __init__(self, env: Any, *counts: int) -> None:
        super().__init__(env)
        self.counts = itertools.cycle(counts)

    def step(self, action: Any) -> Any:
        return [self.env.step(action) for _ in range(next(self.counts))][-1]


class Warm(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Plays steps of its own before an episode begins."""

    def reset(self, **given: Any) -> Any:
        self.env.reset(**given)
        observation, *_, info = self.env.step(np.zeros(2, np.float32))
        return observation, info


class Arm(gymnasium.Env[Any, Any]):
    """Has limits of its own, and says how long its steps are, in one way or two."""

    observation_space = spaces.Box(-1, 1, (1,))
    action_space = spaces.Box(np.float32([-0.2, -0.4]), np.float32([0.2, 0.8]))

    def __init__(self, dt: float | None, rate: float | None) -> None:
        self.metadata = {"render_modes": [], "render_fps": rate}
        if dt is not None:
            self.dt = dt

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        return np.zeros(1, np.float32), {}

    def step(self, action: Any) -> Any:
        return np.zeros(1, np.float32), 0.0, False, False, {}


class Diarist(Walker):
    """Writes down what becomes of it; its end is not always peaceful."""

    def __init__(self, diary: Path, task: np.ndarray, reward: str) -> None:
        super().__init__(task)
        self.diary = diary
        self.write(f"made in {os.getpid()}, {reward}")

    def write(self, line: str) -> None:
        with self.diary.open("a") as file:
            file.write(f"{line}\n")

    def close(self) -> None:
        self.write("closed")
        raise OSError("the door is stuck")


TWO = np.array([True, False])
# What a broken environment returns for `terminated`, `truncated` and `info`.
ODD_ENDS = {
    22: (TWO, False, {}),
    24: (False, False, {"success": TWO}),
    26: (False, False, None),
}


# What it raises.
RAISED = {
    30: ValueError("the gears are stuck"),
    31: ValueError(threading.Lock()),  # which cannot be sent to another process
    34: KeyboardInterrupt("enough"),
}


class Broken(Settable):
    """Does what its task's third number says, at the step that the fourth says.

    What it does in a step, it does in those episodes alone that start on the right.
    """

    def set_task(self, task: np.ndarray) -> None:
        if int(task[2]) == 50:
            raise KeyError("no such task")
        super().set_task(task)

    @property
    def due(self) -> bool:
        return self.unlucky and self.steps == int(self.task[3])

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        self.unlucky = False
        answer = super().reset(seed=seed)
        self.unlucky = bool(self.place[0] > 0)
        return (answer[0], None) if int(self.task[2]) == 51 else answer  # type: ignore[return-value]

    @property
    def action_space(self) -> Any:  # type: ignore[override]
        if int(self.task[2]) == 63:
            raise RuntimeError("no actions today")
        return spaces.Box(-1.0, 2.0 if int(self.task[2]) == 60 else 1.0, (2,))

    @property
    def observation_space(self) -> Any:  # type: ignore[override]
        return spaces.Box(-np.inf, np.inf, (4 if int(self.task[2]) == 62 else 3,))

    def see(self) -> Any:
        seen, kind = super().see(), int(self.task[2])
        if self.due and kind == 10:
            seen[2] = np.nan
        return seen

    def step(self, action: np.ndarray) -> Any:
        kind = int(self.task[2])
        self.task = self.task.copy()
        if self.due and kind in RAISED:
            raise RAISED[kind]
        if self.due and kind == 40:
            time.sleep(3600)
        if self.due and kind == 41:
            os._exit(3)
        if self.due and kind == 42:
            os.closerange(3, 64)  # files that are not its own
        place = self.place + action
        self.place, self.steps = place, self.steps + 1
        reward = np.nan if self.due and kind == 11 else 0.0
        ends = ODD_ENDS[kind] if self.due and kind in ODD_ENDS else (False, False, {})
        answer = self.see(), reward, *ends
        return answer[:4] if self.due and kind == 21 else answer


class Fragile(Settable):
    """Works as long as there is a file."""

    def __init__(self, health: Path, task: np.ndarray) -> None:
        super().__init__(task)
        self.health = health

    def step(self, action: np.ndarray) -> Any:
        if not self.health.exists():
            raise OSError("the robot is not well")
        return super().step(action)


class Chooser(gymnasium.Env[Any, Any]):
    """Rewards the one of three choices, -1 to 1, that is its task."""

    action_space = spaces.Discrete(3, start=-1)
    observation_space = spaces.Box(0, 1, (1,))

    def __init__(self, choice: np.ndarray) -> None:
        self.choice = int(choice[0])

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        return np.zeros(1, np.float32), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action)
        right = int(action) == self.choice
        return np.zeros(1, np.float32), float(right), False, False, {"success": np.float64(right)}


def make_walker(task: np.ndarray, reward: str) -> Walker:
    return Walker(task)


def make_painter(task: np.ndarray, reward: str) -> Walker:
    return Painter(task)


def make_settable(task: np.ndarray, reward: str) -> Settable:
    return Settable(task)


def make_broken(task: np.ndarray, reward: str) -> Broken:
    return Broken(task)


def make_hopeless(how: str, diary: Path, task: np.ndarray, reward: str) -> Any:
    diary.write_text(str(os.getpid()))
    if how == "raises":
        raise OSError("no licence")
    if how == "hangs":
        time.sleep(3600)
    if how == "exits":
        os._exit(3)
    if how == "quits":
        sys.exit(4)
    return gymnasium.Env() if how == "has no spaces" else None


def make_parent(how: str, diary: Path, task: np.ndarray, reward: str) -> Walker:
    """Start a process, as simulators do, and write down which."""
    child = subprocess.Popen(["sleep", "3600"])
    diary.write_text(f"{os.getpid()} {child.pid}\n")
    if how == "hangs":
        ctypes.PyDLL(None).pause()  # in C, without ever letting Python run
    return Walker(task)


def make_fragile(health: Path, task: np.ndarray, reward: str) -> Fragile:
    return Fragile(health, task)


class Stuck(Settable):
    """Raises an error far below its first step."""

    def step(self, action: np.ndarray) -> Any:
        return self.turn_gears(50)

    def turn_gears(self, depth: int) -> Any:
        if depth:
            return self.turn_gears(depth - 1)
        raise ValueError("the gears are stuck" + "!" * 10_000_000)


def make_stuck(task: np.ndarray, reward: str) -> Stuck:
    return Stuck(task)
