"""What a run writes down of every iteration: JSON lines, and events for TensorBoard."""

import contextlib
import json
import logging
import math
import os
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.proto.summary_pb2 import Summary
from tensorboardX.record_writer import RecordWriter

from maesn.storage import explained

logger = logging.getLogger(__name__)

METRICS = "metrics.jsonl"
TIMING = "timing.jsonl"
TENSORBOARD = "tensorboard"

# Numbers that have another name on a TensorBoard. Those without a path go to `charts/`.
_TAGS = {
    "return_before": "returns/before",
    "return_after": "returns/after",
    "success_after": "success/after",
}


class Progress(NamedTuple):
    """One finished iteration."""

    iteration: int
    """Iterations so far, this one included."""
    environment_steps: int
    """Control steps so far."""
    seconds: float
    """Wall time of the iteration, compilation included."""
    compile_seconds: float
    """The part of `seconds` in which programs were compiled: the first iteration, mostly."""
    steps_per_second: float
    """Control steps per second of the time without compilation."""
    info: dict[str, float]
    """What the learner reports, by path: `return_after`, `trust_region/kl`, ..."""

    def find(self, name: str) -> float | None:
        """Return the number in `info` whose path ends so; None if there is none."""
        found = (value for path, value in self.info.items() if path.split("/")[-1] == name)
        return next(found, None)


class JsonLines:
    """A file with one JSON object for each iteration, which can be cut back to any of them."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with explained("open", path):
            # Unbuffered: what could not be written must not be tried again later.
            self._file = path.open("a+b", buffering=0)

    def cut(self, iterations: int) -> None:
        """Keep the lines of iterations 1 ... `iterations`, and nothing after them."""
        kept = end = 0
        with explained("write", self._path):
            for line in self._path.read_bytes().splitlines(keepends=True)[:iterations]:
                if not (line.startswith(b'{"iteration": %d,' % (kept + 1)) and line[-1:] == b"\n"):
                    break
                kept += 1
                end += len(line)
            self._file.truncate(end)
        if kept < iterations:
            logger.warning(
                f"`{self._path}` holds only {kept} of the {iterations} iterations before this one; "
                "the rest is lost, but not for the learner."
            )

    def append(self, record: Mapping[str, float | int]) -> None:
        """Write one line. Numbers that are not finite become null: JSON has none."""
        finite = {n: value if math.isfinite(value) else None for n, value in record.items()}
        line = json.dumps(finite, allow_nan=False).encode() + b"\n"
        with explained("write", self._path):
            while line:  # a disk that is nearly full takes a part of it
                line = line[self._file.write(line) :]

    def sync(self) -> None:
        """Make all lines survive a power cut."""
        with explained("write", self._path):
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class EventLog:
    """Events for TensorBoard, written at once and in this thread.

    If the thread of `tensorboardX.SummaryWriter` dies of a full disk, the next event waits for
    ever.
    """

    def __init__(self, directory: Path, iteration: int, environment_steps: int) -> None:
        self._directory = directory
        # The iteration keeps apart the names of processes that begin within the same second.
        name = f"events.out.tfevents.{int(time.time())}.{iteration}"
        with explained("write", directory):
            directory.mkdir(exist_ok=True)
            self._records = RecordWriter(str(directory / name))
        self.append(file_version="brain.Event:2")
        if iteration:
            # Makes TensorBoard hide what an earlier process wrote of later steps.
            start = SessionLog(status=SessionLog.START)
            self.append(step=environment_steps + 1, session_log=start)

    def append(self, **event: Any) -> None:
        """Write one event of these fields."""
        with explained("write", self._directory):
            self._records.write(Event(wall_time=time.time(), **event).SerializeToString())

    def sync(self) -> None:
        """Make all events survive a power cut."""
        with explained("write", self._directory):
            self._records.flush()

    def close(self) -> None:
        """Close the file."""
        with explained("write", self._directory):
            self._records.close()


class RunLog(NamedTuple):
    """The log files of a run directory; see `open_log`."""

    metrics: JsonLines
    timing: JsonLines
    events: EventLog

    def cut(self, iteration: int) -> None:
        """Keep the lines of iterations 1 ... `iteration`."""
        self.metrics.cut(iteration)
        self.timing.cut(iteration)

    def write(self, progress: Progress) -> None:
        """Write down one iteration; raises `RunError` if the disk is full, or the like."""
        timing = progress._asdict()
        info, steps = timing.pop("info"), progress.environment_steps
        self.timing.append(timing)
        self.metrics.append({"iteration": progress.iteration, "environment_steps": steps, **info})
        scalars = {_TAGS.get(name, name): value for name, value in info.items()}
        scalars |= {"SPS": progress.steps_per_second, "iteration": progress.iteration}
        values = [
            Summary.Value(tag=tag if "/" in tag else f"charts/{tag}", simple_value=value)
            for tag, value in scalars.items()
        ]
        self.events.append(step=steps, summary=Summary(value=values))

    def sync(self) -> None:
        """Make all that was written survive a power cut."""
        for file in self:
            file.sync()


@contextlib.contextmanager
def open_log(directory: Path, iteration: int, environment_steps: int) -> Iterator[RunLog]:
    """Open the log files of a run, and forget what was written of iterations after this one.

    Only one process may do so at a time.
    """
    events = directory / TENSORBOARD
    with (
        contextlib.closing(JsonLines(directory / METRICS)) as metrics,
        contextlib.closing(JsonLines(directory / TIMING)) as timing,
        contextlib.closing(EventLog(events, iteration, environment_steps)) as tensorboard,
    ):
        log = RunLog(metrics, timing, tensorboard)
        log.cut(iteration)
        yield log
