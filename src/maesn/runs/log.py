"""The log of a run: JSON lines and events for TensorBoard, one of each per iteration."""

import contextlib
import json
import logging
import math
import struct
import time
from pathlib import Path
from typing import Any, NamedTuple

from tensorboardX.proto.event_pb2 import Event
from tensorboardX.proto.summary_pb2 import Summary
from tensorboardX.record_writer import masked_crc32c

from maesn.runtime.archive import parse_json
from maesn.storage import explained, write_whole

logger = logging.getLogger(__name__)

METRICS = "metrics.jsonl"
TIMING = "timing.jsonl"


class Progress(NamedTuple):
    """One finished iteration."""

    iteration: int  # iterations so far, this one included
    environment_steps: int  # control steps so far
    seconds: float  # wall time of the iteration
    steps_per_second: float  # control steps per second
    devices: int  # number of devices that shared the tasks
    info: dict[str, float]  # metrics of the learner: `return_after`, `outer/kl`, ...

    def find(self, name: str) -> float | None:
        """Return the number in `info` whose path ends so; None if there is none."""
        return next((x for path, x in self.info.items() if path.split("/")[-1] == name), None)


class RunLog(NamedTuple):
    """The log files of a run directory."""

    metrics: Path
    timing: Path
    events: Path

    @classmethod
    def begin(cls, directory: Path, iterations: int) -> "RunLog":
        """Go on with a log after a number of iterations; lines of later ones are removed."""
        events = directory / "tensorboard" / f"events.out.tfevents.{int(time.time())}"
        log = cls(directory / METRICS, directory / TIMING, events)
        append(events, _event(file_version="brain.Event:2"))
        for path in (log.metrics, log.timing):
            cut_lines(path, iterations)
        return log

    def write(self, progress: Progress) -> None:
        """Write down one iteration; raises `RunError` if the disk is full, or the like."""
        timing = progress._asdict()
        info, steps = timing.pop("info"), progress.environment_steps
        metrics = {"iteration": progress.iteration, "environment_steps": steps, **info}
        for path, record in ((self.timing, timing), (self.metrics, metrics)):
            # JSON has no numbers that are not finite.
            finite = {n: value if math.isfinite(value) else None for n, value in record.items()}
            append(path, json.dumps(finite, allow_nan=False).encode() + b"\n")
        scalars = {**info, "steps_per_second": progress.steps_per_second}
        values = [Summary.Value(tag=tag, simple_value=value) for tag, value in scalars.items()]
        append(self.events, _event(step=steps, summary=Summary(value=values)))


def append(path: Path, content: bytes) -> None:
    """Write at the end of a file; raises `RunError` if not all of it could be written."""
    with explained("write", path):
        path.parent.mkdir(exist_ok=True)
        with path.open("ab") as file:
            file.write(content)


def cut_lines(path: Path, iterations: int) -> None:
    """Keep the sound lines of iterations 1 ... `iterations`."""
    with explained("write", path):
        path.touch()
        content = path.read_bytes()
    numbered: dict[int, bytes] = {}
    for line in content.split(b"\n")[:-1]:
        with contextlib.suppress(ValueError, LookupError, TypeError):
            number = parse_json(line)["iteration"]
            if type(number) is int and 1 <= number <= iterations:
                numbered[number] = line + b"\n"
    if lost := iterations - len(numbered):
        logger.warning(f"`{path}` lacks {lost} of the {iterations} iterations before this one.")
    if (kept := b"".join(numbered[number] for number in sorted(numbered))) != content:
        write_whole(path, kept)


def _event(**fields: Any) -> bytes:
    """Return an event as TensorBoard's files hold it: length and content, each with a checksum."""
    # Once a full disk has ended the thread of `tensorboardX.SummaryWriter`, it waits for ever.
    content = Event(wall_time=time.time(), **fields).SerializeToString()
    parts = (struct.pack("<Q", len(content)), content)
    return b"".join(part + struct.pack("<I", masked_crc32c(part)) for part in parts)
