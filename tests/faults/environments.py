"""Gymnasium environments that are at fault: the failure is named, and no process is left."""

import os
import pickle
import random
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from faults.material import Material
from faults.strange_worlds import DUE, STEPS, WORLDS, draw_tasks, make, make_all
from faults.table import CLEAR, CONTINUED, LOSS, Findings
from strange_families import is_running

from maesn.envs.foreign import gymnasium_family
from maesn.foreign import WorkerError, WorkerPool
from maesn.storage import RunError
from maesn.worlds import EnvContractError, check_env_contract

HARMLESS = {"step: prints", "step: leaves a thread", "step: warns", "close: raises"}
"""What an environment may do."""
TIME_LIMIT = 2.0
LONGEST = 5000
"""Characters of a message."""


def attempt(stream: random.Random, _: Material, __: Path, findings: Findings) -> None:
    """Make a family, look at it, and play an episode."""
    name, everywhere = stream.choice(list(WORLDS)), stream.random() < 0.5
    processes: list[int] = []
    with _quiet():
        said = _attacked(name, everywhere, processes)
    what = f"{name}, {'every' if everywhere else 'one'} task: {said[:LONGEST]}"
    left = any(map(is_running, processes))
    if left or len(said) > LONGEST or bool(said) == (name in HARMLESS):
        findings.add(LOSS, f"{what} ({len(said)} characters; a process is left: {left})")
    else:
        findings.add(CLEAR if said else CONTINUED, what)


def _attacked(name: str, everywhere: bool, processes: list[int]) -> str:
    """Return what the library says of an environment; nothing if it can be played in."""
    make_env = partial(make_all if everywhere else make, name)
    settings: dict[str, Any] = {"horizon": STEPS, "time_limit": TIME_LIMIT}
    try:
        env = gymnasium_family("strange", make_env, draw_tasks, **settings).make_env()
        if everywhere:
            check_env_contract(env, np.zeros(1, np.float32))
        recipe = (env.recipe.make_env, env.reward_kind, env.interface)
        with closing(WorkerPool(recipe, 2, TIME_LIMIT)) as pool:
            _play(pool, processes)
    except (WorkerError, EnvContractError, RunError, ValueError) as error:
        return str(error)
    return ""


@contextmanager
def _quiet() -> Iterator[None]:
    """Let the processes that start in the block write to nowhere."""
    with Path(os.devnull).open("w") as nowhere, ExitStack() as stack:
        for number in (1, 2):
            kept = os.dup(number)
            stack.callback(os.close, kept)
            stack.callback(os.dup2, kept, number)
            os.dup2(nowhere.fileno(), number)
        yield


def _play(pool: WorkerPool, processes: list[int]) -> None:
    """Play two episodes side by side, of which one goes wrong."""
    tasks = [pickle.dumps(np.float32([number])) for number in (0, 2)]
    pool.begin(tasks, [3, 4])
    processes += pool.process_ids
    for _ in range(DUE + 1):
        pool.step(np.zeros((2, 2), np.float32))
