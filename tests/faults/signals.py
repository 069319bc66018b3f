"""Signals that end a program, once or twice, at random moments."""

import os
import random
import signal
import sys
import time
from functools import partial
from pathlib import Path

from faults.material import Material
from faults.processes import fork, wait
from faults.table import CONTINUED, LOSS, TRACEBACK, Findings
from small_runs import finish, outcome

from maesn import cli
from maesn.runs.run import Run

NUMBERS = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
READY = "ready\n"


def command(*words: str) -> None:
    """Run a command as a program does."""
    sys.argv = ["maesn", *words]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    print(READY, end="")
    cli.main()


def attempt(stream: random.Random, material: Material, directory: Path, findings: Findings) -> None:
    """Send signals to a process that trains, then go on."""
    run, said = material.long(directory / "run"), directory / "said"
    process = fork(partial(command, "resume", str(run.directory)), said)
    while not (said.exists() and said.read_text()):
        time.sleep(0.001)
    sent = [(stream.uniform(1e-3, 0.6), stream.choice(NUMBERS))]
    sent += [(stream.choice([0.0, 1e-3, 0.02]), stream.choice(NUMBERS))] * stream.randrange(2)
    for seconds, number in sent:
        time.sleep(seconds)
        os.kill(process, number)
    ended = wait(process, said)
    what = f"{sent}: status {ended.status}, {ended.said[-2000:]}"
    numbers = {number for _, number in sent}
    # Python says so itself where Ctrl-C comes before the command or after it.
    told = "Traceback" in ended.said and "KeyboardInterrupt" not in ended.said
    if told or ended.status not in ({0} | {128 + n for n in numbers} | {-n for n in numbers}):
        findings.add(TRACEBACK, what)
        return
    same = outcome(finish(Run.open(run.directory))) == material.long_outcome
    findings.add(CONTINUED if same else LOSS, what)
