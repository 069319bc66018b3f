"""Disks that are full or failing."""

import errno
import random
from functools import partial
from pathlib import Path
from typing import Any

from faults.kills import LARGEST
from faults.material import Material
from faults.processes import failing_at, fork, on_a_full_disk, wait
from faults.scenarios import SCENARIOS, operations
from faults.table import CLEAR, CONTINUED, LOSS, TRACEBACK, Findings

from maesn.storage import RunError

REASONS = (errno.ENOSPC, errno.EROFS, errno.EIO, errno.EDQUOT, errno.EACCES)
REFUSED = 3


def attempt(stream: random.Random, material: Material, directory: Path, findings: Findings) -> None:
    """Let one operation fail, or all that write; then go on, on a sound disk."""
    name = stream.choice(list(SCENARIOS))
    SCENARIOS[name].prepare(material, directory)
    work = partial(SCENARIOS[name].work, material, directory)
    if stream.random() < 0.5:
        moment, reason = stream.randrange(operations(name, material)), stream.choice(REASONS)
        failing = failing_at(work, moment, reason)
        what = f"{name}, {errno.errorcode[reason]} at operation {moment}"
    else:
        size = stream.randrange(LARGEST)
        failing, what = on_a_full_disk(work, size), f"{name}, EFBIG at {size} bytes"
    said = directory / "said"
    ended = wait(fork(partial(refusing, failing), said), said)
    if ended.status not in (0, REFUSED):
        findings.add(TRACEBACK, f"{what}: status {ended.status}, {ended.said}")
        return
    lost = SCENARIOS[name].lost(material, directory)
    outcome = CLEAR if ended.status == REFUSED else CONTINUED
    findings.add(LOSS if lost else outcome, f"{what}: {lost} ({ended.said})")


def refusing(work: Any) -> None:
    """Do the work; end with a sentence and an exit status where it cannot be done."""
    try:
        work()
    except (RunError, OSError) as error:  # the runtime documents the second
        print(error)
        raise SystemExit(REFUSED) from error
