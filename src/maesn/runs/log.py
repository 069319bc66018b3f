"""What a run writes down of every iteration: JSON lines, and events for TensorBoard."""

import contextlib
import itertools
import json
import logging
import math
import os
import struct
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.proto.summary_pb2 import Summary
from tensorboardX.record_writer import masked_crc32c
from tensorboardX.summary import text

from maesn.runs.checkpoint import Checkpoint
from maesn.storage import explained, write_whole

logger = logging.getLogger(__name__)

METRICS = "metrics.jsonl"
TIMING = "timing.jsonl"
TENSORBOARD = "tensorboard"

_VERSION = "brain.Event:2"  # of the format of TensorBoard's files

# Numbers that have another name on a TensorBoard. Those without a path go to `charts/`.
_TAGS = {
    "return_before": "returns/before",
    "return_after": "returns/after",
    "success_after": "success/after",
}


class Progress(NamedTuple):
    """One finished iteration."""

    iteration: int  # iterations so far, this one included
    environment_steps: int  # control steps so far
    seconds: float  # wall time of the iteration, compilation included
    compile_seconds: float  # the part in which programs were compiled: mostly the first iteration
    steps_per_second: float  # control steps per second of the time without compilation
    devices: int  # that shared the tasks
    info: dict[str, float]  # what the learner reports: `return_after`, `trust_region/kl`, ...

    def find(self, name: str) -> float | None:
        """Return the number in `info` whose path ends so; None if there is none."""
        found = (value for path, value in self.info.items() if path.split("/")[-1] == name)
        return next(found, None)


class RunLog(NamedTuple):
    """The log files of a run directory; see `begin_log`."""

    metrics: Path
    timing: Path
    events: Path

    def write(self, progress: Progress) -> None:
        """Write down one iteration; raises `RunError` if the disk is full, or the like."""
        timing = progress._asdict()
        info, steps = timing.pop("info"), progress.environment_steps
        metrics = {"iteration": progress.iteration, "environment_steps": steps, **info}
        for path, record in ((self.timing, timing), (self.metrics, metrics)):
            # JSON has no numbers that are not finite.
            finite = {n: value if math.isfinite(value) else None for n, value in record.items()}
            append(path, json.dumps(finite, allow_nan=False).encode() + b"\n")
        scalars = {_TAGS.get(name, name): value for name, value in info.items()}
        scalars |= {"SPS": progress.steps_per_second, "iteration": progress.iteration}
        values = [
            Summary.Value(tag=tag if "/" in tag else f"charts/{tag}", simple_value=value)
            for tag, value in scalars.items()
        ]
        append(self.events, _event(step=steps, summary=Summary(value=values)))

    def cut(self, iterations: int) -> None:
        """Keep the lines of iterations 1 ... `iterations`."""
        for path in (self.metrics, self.timing):
            cut_lines(path, iterations)

    def sync(self) -> None:
        """Make all that was written survive a power cut."""
        for path in self:
            with explained("write", path), path.open("ab") as file:
                os.fsync(file.fileno())


def begin_log(directory: Path, start: Checkpoint, settings: Mapping[str, Any]) -> RunLog:
    """Forget what was logged of iterations after a checkpoint, and show settings, by path."""
    iteration, steps = start.iteration, start.environment_steps
    # The iteration keeps apart the names of processes that begin within the same second.
    events = _events_file(directory, f"{int(time.time())}.{iteration}")
    log = RunLog(directory / METRICS, directory / TIMING, events)
    table = "".join(f"| {name} | {value} |\n" for name, value in settings.items())
    summary = text("settings", f"| setting | value |\n|-|-|\n{table}")
    content = _event(file_version=_VERSION)
    if iteration:
        # Makes TensorBoard hide what an earlier process wrote of later steps.
        content += _event(step=steps + 1, session_log=SessionLog(status=SessionLog.START))
    append(events, content + _event(step=steps, summary=summary))
    for path in (log.metrics, log.timing):
        kept = cut_lines(path, iteration)
        if len(kept) < iteration:
            first = next(n for n in itertools.count(1) if n not in kept)
            logger.warning(
                f"`{path}` lacks {iteration - len(kept)} of the {iteration} iterations before this "
                f"one, the first of them {first}. The learner has not lost them."
            )
    return log


def log_figures(directory: Path, pictures: Sequence[Path], environment_steps: int) -> None:
    """Show PNGs on a run's TensorBoard, in place of those of the last time."""
    content = _event(file_version=_VERSION)
    for picture in pictures:
        png = picture.read_bytes()
        width, height = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))
        image = Summary.Image(width=width, height=height, colorspace=4, encoded_image_string=png)
        value = Summary.Value(tag=f"figures/{picture.stem}", image=image)
        content += _event(step=environment_steps, summary=Summary(value=[value]))
    events = _events_file(directory, "0.figures")
    with explained("write", events):
        events.unlink(missing_ok=True)
    append(events, content)


def append(path: Path, content: bytes) -> None:
    """Write at the end of a file; raises `RunError` if not all of it could be written."""
    with explained("write", path):
        path.parent.mkdir(exist_ok=True)  # again, where a user has removed old events
        # Unbuffered: what could not be written must not be tried again later.
        with path.open("ab", buffering=0) as file:
            while content:  # a disk that is nearly full takes a part of it
                content = content[file.write(content) :]


def cut_lines(path: Path, iterations: int) -> set[int]:
    """Keep the sound lines of iterations 1 ... `iterations`, and return those that have one."""
    with explained("write", path):
        path.touch()
        content = path.read_bytes()
    numbered: dict[int, bytes] = {}
    for line in content.split(b"\n")[:-1]:
        # What is no record of an iteration is damaged.
        with contextlib.suppress(ValueError, LookupError, TypeError, RecursionError):
            found = json.loads(line)["iteration"]
            if type(found) is int and 1 <= found <= iterations:
                numbered[found] = line + b"\n"
    sound = b"".join(numbered[n] for n in sorted(numbered))
    if content.startswith(sound):
        with explained("write", path):
            os.truncate(path, len(sound))  # for which a full disk has room
    else:
        write_whole(path, sound)
    return set(numbered)


def _events_file(directory: Path, name: str) -> Path:
    return directory / TENSORBOARD / f"events.out.tfevents.{name}"


def _event(**fields: Any) -> bytes:
    """Return an event as TensorBoard's files hold it: length and content, each with a checksum."""
    # Once a full disk has ended the thread of `tensorboardX.SummaryWriter`, it waits for ever.
    content = Event(wall_time=time.time(), **fields).SerializeToString()
    parts = (struct.pack("<Q", len(content)), content)
    return b"".join(part + struct.pack("<I", masked_crc32c(part)) for part in parts)
