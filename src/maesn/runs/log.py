"""What a run writes down of every iteration: JSON lines, and events for TensorBoard."""

import contextlib
import itertools
import json
import logging
import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.proto.summary_pb2 import Summary
from tensorboardX.record_writer import RecordWriter
from tensorboardX.summary import text

from maesn.storage import explained, write_whole

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
    devices: int
    """Devices that shared the tasks."""
    info: dict[str, float]
    """What the learner reports, by path: `return_after`, `trust_region/kl`, ..."""

    def find(self, name: str) -> float | None:
        """Return the number in `info` whose path ends so; None if there is none."""
        found = (value for path, value in self.info.items() if path.split("/")[-1] == name)
        return next(found, None)


class JsonLines:
    """A file with one JSON object for each iteration, which can be cut back to any of them."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with explained("open", path):
            # Unbuffered: what could not be written must not be tried again later.
            self._file = path.open("a+b", buffering=0)

    def cut(self, iterations: int) -> tuple[int, int]:
        """Keep the sound lines of iterations 1 ... `iterations`.

        Returns:
            How many of these have none, and the first of them.
        """
        with explained("write", self.path):
            content = self.path.read_bytes()
            numbered = {_iteration(line): line for line in content.splitlines(keepends=True)}
            kept = sorted(n for n in numbered if n is not None and 1 <= n <= iterations)
            sound = b"".join(numbered[n] for n in kept)
            if content.startswith(sound):
                self._file.truncate(len(sound))
            else:  # damaged in the middle
                write_whole(self.path, sound)
                self._file.close()
                self._file = self.path.open("a+b", buffering=0)
        agree = (found == wanted for wanted, found in enumerate(kept, start=1))
        return iterations - len(kept), 1 + sum(itertools.takewhile(bool, agree))

    def append(self, record: Mapping[str, float | int]) -> None:
        """Write one line. Numbers that are not finite become null: JSON has none."""
        finite = {n: value if math.isfinite(value) else None for n, value in record.items()}
        line = json.dumps(finite, allow_nan=False).encode() + b"\n"
        with explained("write", self.path):
            while line:  # a disk that is nearly full takes a part of it
                line = line[self._file.write(line) :]

    def sync(self) -> None:
        """Make all lines survive a power cut."""
        with explained("write", self.path):
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _iteration(line: bytes) -> int | None:
    """Return the number of the iteration that a line is about; None if the line is damaged."""
    with contextlib.suppress(ValueError, RecursionError):
        record = json.loads(line)
        if line.endswith(b"\n") and isinstance(record, dict):
            found = record.get("iteration")
            return found if type(found) is int else None
    return None


class EventLog:
    """Events for TensorBoard, written at once and in this thread."""

    # Once a full disk has ended the thread of `tensorboardX.SummaryWriter`, it waits for ever.

    def __init__(
        self, directory: Path, iteration: int, environment_steps: int, name: str = ""
    ) -> None:
        self._directory = directory
        # The iteration keeps apart the names of processes that begin within the same second.
        name = f"events.out.tfevents.{name or f'{int(time.time())}.{iteration}'}"
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


def log_figures(directory: Path, pictures: Sequence[Path], environment_steps: int) -> None:
    """Show PNGs on a run's TensorBoard, in place of those of the last time."""
    events = EventLog(directory / TENSORBOARD, 0, environment_steps, name="0.figures")
    with contextlib.closing(events):
        for picture in pictures:
            content = picture.read_bytes()
            width, height = (int.from_bytes(content[at : at + 4], "big") for at in (16, 20))
            image = Summary.Image(
                width=width, height=height, colorspace=4, encoded_image_string=content
            )
            value = Summary.Value(tag=f"figures/{picture.stem}", image=image)
            events.append(step=environment_steps, summary=Summary(value=[value]))


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
def open_log(
    directory: Path, iteration: int, environment_steps: int, settings: Mapping[str, Any]
) -> Iterator[RunLog]:
    """Open the log files of a run, and forget what was written of iterations after this one.

    The settings, by path, stand on the TensorBoard as a table.
    """
    events = directory / TENSORBOARD
    with (
        contextlib.closing(JsonLines(directory / METRICS)) as metrics,
        contextlib.closing(JsonLines(directory / TIMING)) as timing,
        contextlib.closing(EventLog(events, iteration, environment_steps)) as tensorboard,
    ):
        log = RunLog(metrics, timing, tensorboard)
        table = "".join(f"| {name} | {value} |\n" for name, value in settings.items())
        tensorboard.append(
            step=environment_steps, summary=text("settings", f"| setting | value |\n|-|-|\n{table}")
        )
        for file in (metrics, timing):
            missing, first = file.cut(iteration)
            if missing:
                logger.warning(
                    f"`{file.path}` lacks {missing} of the {iteration} iterations before this "
                    f"one, the first of them {first}. The learner has not lost them."
                )
        yield log
