"""The training loop, which ends well however it is stopped, and its live display."""

import contextlib
import dataclasses
import datetime
import functools
import logging
import math
import time
from collections import deque
from collections.abc import Generator, Iterator
from typing import Any

import jax
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
from rich.progress import Progress as Bar
from rich.table import Column

from maesn.experience.episodes import Episodes
from maesn.numerics.mesh import num_devices
from maesn.numerics.processes import check_agreement, is_lead, together, total_of_processes
from maesn.runs.checkpoint import Checkpoint, named_leaves, prune
from maesn.runs.compilation import compile_seconds
from maesn.runs.config import installed_versions
from maesn.runs.log import Progress, RunLog, begin_log
from maesn.runs.run import Run
from maesn.runs.signals import ending_by_signals
from maesn.settings import check_number, leaves
from maesn.storage import RunError, refusals
from maesn.worlds.collector import Collector

logger = logging.getLogger(__name__)

# Every draw of an iteration is fresh, so one bad step is bad luck. Five in a row are not.
MAX_NONFINITE = 5

# The latest checkpoints that stay: others than the last one in case that it is damaged.
KEEP = 3


def train(run: Run, iterations: int | None = None, keep: int = KEEP) -> Generator[Progress]:
    """Train from the latest checkpoint to the last iteration; resuming is the same thing.

    n iterations, an end of any kind, and m more are n + m iterations bit for bit, `metrics.jsonl`
    included, on the same machine with the same versions and number of threads. A checkpoint is
    written every `checkpoint_every` iterations and at any end but that of the process.

    `iterations` is the total; None for that of the run's settings. `keep` is how many of the latest
    checkpoints stay, see `maesn.runs.checkpoint.prune`; 0: all.

    Raises:
        RunError: the run cannot be read or written, or another process trains it; or losses or
            gradients were not finite several times in a row.
        EpisodeError: an episode went wrong: physics blew up, or a foreign environment failed.
    """
    total = run.settings.iterations if iterations is None else iterations
    with refusals():
        check_number("iterations", total, 0)
        check_number("keep", keep, 0)
        run.learner.check_batch(run.settings.episodes_per_task)
    with contextlib.ExitStack() as stack:
        if is_lead():
            stack.enter_context(run.alone())
        start = run.latest()
        # Before anything is written: all have read the same by then.
        check_agreement(start.iteration, "the iteration that they begin with")
        check_agreement(int(run.config.digest()[:8], 16), "the settings")
        settings = leaves(run.config.document())
        log = begin_log(run.directory, start, settings) if is_lead() else None
        if start.iteration:
            _compare_versions(run)
        world = stack.enter_context(contextlib.closing(run.world()))
        training = _Training(run, log, keep, start, saved=start.iteration)
        # Again if the first time is interrupted: there is nothing left to do otherwise.
        stack.callback(training.end)
        stack.callback(training.end)
        collect = Collector(world, run.settings.episodes_per_task, watch=training.count)
        while training.checkpoint.iteration < total:
            yield training.advance(collect)


@dataclasses.dataclass
class _Training:
    """A run between two iterations."""

    run: Run
    log: RunLog | None  # None in a process that leaves writing to another one
    keep: int
    checkpoint: Checkpoint
    saved: int  # iteration of the latest checkpoint on disk
    steps: int = 0  # control steps that were played in the present iteration
    nonfinite: int = 0  # iterations in a row whose step was not finite

    def count(self, episodes: Episodes, *_: Any) -> None:
        self.steps += int(np.asarray(episodes.valid).sum())

    def advance(self, collect: Collector) -> Progress:
        """Do one iteration and write it down."""
        before, run, self.steps = self.checkpoint, self.run, 0
        key = run.iteration_key(before.iteration)
        start, compiled = time.perf_counter(), compile_seconds()
        with together():
            state, info = run.learner.step(key, before.state, collect)
            jax.block_until_ready((state, info))  # type: ignore[no-untyped-call]
            self.steps = total_of_processes(self.steps)
        seconds, compiling = time.perf_counter() - start, compile_seconds() - compiled
        after = Checkpoint(state, before.iteration + 1, before.environment_steps + self.steps)
        metrics = jax.device_get(run.learner.metrics(info))
        progress = Progress(
            iteration=after.iteration,
            environment_steps=after.environment_steps,
            seconds=seconds,
            compile_seconds=compiling,
            steps_per_second=self.steps / max(seconds - compiling, 1e-9),
            devices=num_devices(),
            info={name: float(value) for name, value in named_leaves(metrics).items()},
        )
        if self.log is not None:
            self.log.write(progress)
        # One assignment, so that Ctrl-C finds either all of this iteration or nothing.
        self.checkpoint = after
        self._watch(progress)
        if after.iteration % run.settings.checkpoint_every == 0:
            self._save()
        return progress

    def end(self) -> None:
        """Leave log and checkpoint in agreement, whatever was interrupted."""
        if self.log is not None:
            self.log.cut(self.checkpoint.iteration)
        self._save()

    def _save(self) -> None:
        """Write a checkpoint unless it is there already, and delete those that are not kept."""
        if self.log is None or self.saved == self.checkpoint.iteration:
            return
        # The log first: whoever finds a checkpoint can rely on the log up to it.
        self.log.sync()
        path = self.run.save_state(self.checkpoint.state, self.checkpoint.environment_steps)
        self.saved = self.checkpoint.iteration
        if self.keep:
            prune(path, self.keep)

    def _watch(self, progress: Progress) -> None:
        """Say that a step was not finite, and give up after several in a row."""
        broken = [name for name, value in progress.info.items() if not math.isfinite(value)]
        tasks = int(progress.info.get("nonfinite_tasks", 0))
        if progress.find("accepted") or not (broken or tasks):
            self.nonfinite = 0
            return
        self.nonfinite += 1
        first = int(progress.info.get("first_nonfinite_task", -1))
        named = f" (task {first} is the first)" if first >= 0 else ""
        what = f"the loss of {tasks} tasks{named}" if tasks else f"`{broken[0]}`"
        said = f"`{self.run.directory}`, iteration {progress.iteration}: {what} is not finite"
        logger.warning("%s. The step was rejected; the policy is as before.", said)
        if self.nonfinite == MAX_NONFINITE:
            raise RunError(
                f"{said}, for the {MAX_NONFINITE}th time in a row. The last good state is saved: "
                "look at `metrics.jsonl`, and start anew with smaller steps or a smaller penalty."
            )


def _compare_versions(run: Run) -> None:
    now = installed_versions(run.config.engine)
    for name, version in run.config.versions.items():
        if now.get(name) != version:
            logger.warning(
                f"`{run.directory}` was begun with {name} {version} and goes on with "
                f"{now.get(name)}: it need not become what it would have become without a break."
            )


def train_live(
    run: Run, iterations: int | None = None, keep: int = KEEP, console: Console | None = None
) -> Progress | None:
    """Train and show how it goes: one live line on a terminal, else one line per iteration.

    Returns the last iteration, None if nothing was left to do. All else is as for `train`.
    """
    console = console or Console(quiet=not is_lead())
    # As it is: no markup, no colours, no line breaks of its own.
    say = functools.partial(console.print, markup=False, highlight=False, soft_wrap=True)
    total = run.settings.iterations if iterations is None else iterations
    last: Progress | None = None
    # Without compilation, the mean duration of these predicts the time that is left.
    recent: deque[float] = deque(maxlen=20)
    try:
        with (
            ending_by_signals(),
            contextlib.closing(train(run, iterations, keep)) as steps,
            _live_bar(console, total) as bar,
        ):
            for last in steps:
                recent.append(last.seconds - last.compile_seconds)
                mean, done, text = sum(recent) / len(recent), last.iteration, describe(last)
                left = f"{datetime.timedelta(seconds=round(mean * (total - done)))} left"
                if console.is_terminal:
                    shown = f"{left}: {text}"
                    bar.update(bar.task_ids[0], completed=done, description=shown, refresh=True)
                else:
                    say(f"{done}/{total}: {text}, {left}")
    except (KeyboardInterrupt, SystemExit):
        more = "" if total == run.settings.iterations else f" --iterations {total}"
        more += run.family_option
        with contextlib.suppress(OSError):
            say(f"Stopped, and saved. To go on: maesn resume {run.directory}{more}")
        raise
    if last is None:
        done = run.latest().iteration
        say(f"{run.directory} has done {done} of {total} iterations: nothing is left.")
    return last


def describe(progress: Progress) -> str:
    """Return one iteration in a line of text."""
    info, parts = progress.info, []
    if "return_before" in info and "return_after" in info:
        parts.append(f"return {info['return_before']:.1f} -> {info['return_after']:.1f}")
    if "success_after" in info:
        parts.append(f"success {info['success_after']:.0%}")
    kl = progress.find("kl")
    if kl is not None:
        rejected = progress.find("accepted") == 0.0
        parts.append("step rejected" if rejected else f"KL {kl:.4f}")
    parts.append(f"{progress.steps_per_second:,.0f} steps/s")
    if progress.compile_seconds > 1:
        parts.append(f"compiled for {progress.compile_seconds:.0f} s")
    return ", ".join(parts)


@contextlib.contextmanager
def _live_bar(console: Console, total: int) -> Iterator[Bar]:
    """Show a bar of one task if there is a terminal."""
    columns: list[Any] = [
        MofNCompleteColumn(table_column=Column(min_width=2 * len(str(total)) + 1)),
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True)),
    ]
    if console.width >= 110:  # there is room for it beside the numbers
        columns.insert(1, BarColumn(bar_width=20, table_column=Column(min_width=20)))
    # A thread that refreshes it would outlive the terminal.
    bar = Bar(*columns, console=console, auto_refresh=False)
    bar.add_task("compiling", total=total)
    if console.is_terminal:
        bar.start()
    try:
        yield bar
    finally:
        with contextlib.suppress(OSError):  # the terminal may be what is gone
            if console.is_terminal:
                bar.stop()
