"""Two processes that write to one run at the same time."""

import random
import time
from functools import partial
from pathlib import Path

from faults.disks import REFUSED, refusing
from faults.material import LONG, Material
from faults.processes import fork, wait
from faults.scenarios import SCENARIOS
from faults.signals import command
from faults.table import CLEAR, CONTINUED, LOSS, TRACEBACK, Findings
from small_runs import finish, outcome

from maesn.cli import USAGE_ERROR
from maesn.runs.run import Run

FIRST = f"\n1/{LONG}: "
"""What a process says that trains from the beginning."""


def attempt(stream: random.Random, material: Material, directory: Path, findings: Findings) -> None:
    """Let two processes make one run, or train it; go on, and compare."""
    makes = stream.random() < 0.5
    if makes:
        work = partial(refusing, partial(SCENARIOS["create"].work, material, directory))
    else:
        material.long(directory / "run")
        work = partial(command, "resume", str(directory / "run"))
    outputs = [directory.with_suffix(f".{number}") for number in range(2)]
    processes = []
    for output in outputs:
        processes.append(fork(work, output))
        time.sleep(stream.choice([0.0, stream.uniform(0, 0.3)]))
    ended = [wait(*both) for both in zip(processes, outputs, strict=True)]
    what = f"{'create' if makes else 'resume'} twice: " + "; ".join(map(str, ended))
    refused = {REFUSED, USAGE_ERROR}
    if any(one.status not in {0} | refused or "Traceback" in one.said for one in ended):
        findings.add(TRACEBACK, what)
    elif sum(one.status == 0 and (makes or FIRST in one.said) for one in ended) > 1:
        findings.add(LOSS, f"{what}: both have done the work")
    elif _lost(makes, material, directory):
        findings.add(LOSS, what)
    else:
        findings.add(CLEAR if any(one.status in refused for one in ended) else CONTINUED, what)


def _lost(makes: bool, material: Material, directory: Path) -> bool:
    if makes:
        return bool(SCENARIOS["create"].lost(material, directory))
    return outcome(finish(Run.open(directory / "run"))) != material.long_outcome
