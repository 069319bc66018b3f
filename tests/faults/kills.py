"""SIGKILL at any operation on files, and in the middle of a write."""

import random
import signal
from functools import partial
from pathlib import Path

from faults.material import Material
from faults.processes import failing_at, fork, killed_in_write, wait
from faults.scenarios import SCENARIOS, operations
from faults.table import CONTINUED, LOSS, TRACEBACK, Findings

LARGEST = 6000
"""Bytes of the files that small runs write, and some more."""

EXPECTED = (0, -signal.SIGKILL, -signal.SIGXFSZ)


def attempt(stream: random.Random, material: Material, directory: Path, findings: Findings) -> None:
    """Kill one process, go on where it was, and compare."""
    name = stream.choice(list(SCENARIOS))
    scenario = SCENARIOS[name]
    scenario.prepare(material, directory)
    work = partial(scenario.work, material, directory)
    if stream.random() < 0.25:
        dying, what = killed_in_write(work, size := stream.randrange(LARGEST)), f"byte {size}"
    else:
        moment = stream.randrange(operations(name, material))
        dying, what = failing_at(work, moment), f"operation {moment}"
    ended = wait(fork(dying, directory / "said"), directory / "said")
    what = f"{name}, killed at {what}"
    if ended.status not in EXPECTED:
        findings.add(TRACEBACK, f"{what}: status {ended.status}, {ended.said}")
        return
    lost = scenario.lost(material, directory)
    findings.add(LOSS if lost else CONTINUED, f"{what}: {lost}")
