"""Gymnasium environments that are at fault: the failure is named, and no process is left."""

import os
import random
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path

import numpy as np
from faults.material import Material
from faults.strange_worlds import ANSWERS, DUE, FAULTS, HARMLESS, make
from faults.table import CLEAR, CONTINUED, LOSS, Findings
from strange_families import family_of, is_running

from maesn.foreign import WorkerError, pack_task
from maesn.worlds import EnvContractError, check_env_contract

TIME_LIMIT = 2.0
LONGEST = 5000
"""Characters of a message."""
TASKS = np.float32([[0, 0, 0, 0], [1, 0, 0, 0]])
"""Of two episodes that are played side by side: the second one goes wrong."""


def attempt(stream: random.Random, _: Material, __: Path, findings: Findings) -> None:
    """Play in an environment, perhaps after a look at it, which most faults do not show in."""
    name, looked = stream.choice([*FAULTS, *ANSWERS]), stream.random() < 0.5
    processes: list[int] = []
    with _quiet():
        said = _attacked(name, looked, processes)
    what = f"{name}, {'looked at' if looked else 'played in'}: {said[:LONGEST]}"
    left = any(map(is_running, processes))
    if left or len(said) > LONGEST or bool(said) == (name in HARMLESS):
        findings.add(LOSS, f"{what} ({len(said)} characters; a process is left: {left})")
    else:
        findings.add(CLEAR if said else CONTINUED, what)


def _attacked(name: str, looked: bool, processes: list[int]) -> str:
    """Return what the library says of an environment; nothing if it can be played in."""
    try:
        env = family_of(partial(make, name), time_limit=TIME_LIMIT).make_env()
        if looked:
            check_env_contract(env, TASKS[1])
        with closing(env.open_pool(2)) as pool:
            pool.begin([pack_task(task) for task in TASKS], [3, 4])
            processes += pool.process_ids
            for _ in range(DUE + 1):
                pool.step(np.zeros((2, 2), np.float32))
    except (WorkerError, EnvContractError) as error:
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
