"""The training loop, which saves its state however it is stopped."""

import contextlib
import dataclasses
import datetime
import functools
import logging
import math
import time
from collections.abc import Callable, Generator, Iterator
from typing import Any

import jax
import numpy as np
from rich.console import Console
from rich.live import Live
from rich.text import Text

from maesn.experience.episodes import Episodes
from maesn.numerics.mesh import num_devices
from maesn.runs.checkpoint import Checkpoint, named_leaves
from maesn.runs.config import installed_versions, read_config
from maesn.runs.log import Progress, RunLog
from maesn.runs.process import ending_by_signals
from maesn.runs.run import CHECKPOINTS, Run
from maesn.runtime.archive import PARTIAL
from maesn.settings import check_number
from maesn.storage import RunError, locked, refusals
from maesn.worlds.collector import Collector

logger = logging.getLogger(__name__)

# Every draw of an iteration is fresh, so one bad step is bad luck. Five in a row are not.
MAX_NONFINITE = 5

# Number of checkpoints that stay. The last one alone could be damaged.
KEEP = 3


def train(run: Run, iterations: int | None = None, keep: int = KEEP) -> Generator[Progress]:
    """Train from the latest checkpoint to the last iteration; resuming is the same thing.

    n iterations, an end of any kind, and m more are n + m iterations bit for bit, `metrics.jsonl`
    included, on the same machine with the same versions and number of threads. A checkpoint is
    written every `checkpoint_every` iterations and at any end but that of the process.
    `iterations` is the total; None for that of the run's settings. The first checkpoint and the
    latest `keep` stay; 0: all stay.

    Raises:
        RunError: the run cannot be read or written, another process trains it, or steps were not
            finite several times in a row.
        EpisodeError: an episode went wrong: physics blew up, or a foreign environment failed.
    """
    total = run.settings.iterations if iterations is None else iterations
    with refusals():
        check_number("iterations", total, 0)
        check_number("keep", keep, 0)
        run.learner.check_batch(run.settings.episodes_per_task)
    with contextlib.ExitStack() as stack:
        stack.enter_context(locked(run.directory))
        for folder in (run.directory, run.directory / CHECKPOINTS):
            for partial in folder.glob(f"*{PARTIAL}"):  # left by processes that were killed
                partial.unlink(missing_ok=True)
        if read_config(run.directory).digest() != run.config.digest():
            raise RunError(f"`{run.directory}` was changed since it was opened: open it again.")
        start = run.latest()
        if not start.is_whole:
            logger.warning(
                "The replay of `%s` is gone, damaged or of an older layout: it begins empty.",
                run.directory,
            )
        log = RunLog.begin(run.directory, start.iteration)
        begun = run.config.versions
        if start.iteration and begun != installed_versions(run.config.engine):
            logger.warning("`%s` was begun with other versions: %s.", run.directory, begun)
        world = stack.enter_context(contextlib.closing(run.world()))
        training = _Training(run, log, keep, start, saved=start.iteration)
        # Twice: if a signal interrupts the first call, the second one saves.
        stack.callback(training.save)
        stack.callback(training.save)
        collect = Collector(world, run.settings.episodes_per_task, watch=training.count)
        while training.checkpoint.iteration < total:
            yield training.advance(collect)


@dataclasses.dataclass
class _Training:
    """A run between two iterations."""

    run: Run
    log: RunLog
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
        start = time.perf_counter()
        state, info = run.learner.step(key, before.state, collect)
        jax.block_until_ready((state, info))  # type: ignore[no-untyped-call]
        seconds = time.perf_counter() - start
        after = Checkpoint(state, before.iteration + 1, before.environment_steps + self.steps)
        metrics = jax.device_get(run.learner.metrics(info))
        has_success = collect.world.env.defines_success
        progress = Progress(
            iteration=after.iteration,
            environment_steps=after.environment_steps,
            seconds=seconds,
            steps_per_second=self.steps / seconds,
            devices=num_devices(),
            info={
                name: float(value)
                for name, value in named_leaves(metrics).items()
                if has_success or name != "success_after"
            },
        )
        self.log.write(progress)
        # One assignment, so that Ctrl-C finds either all of this iteration or nothing.
        self.checkpoint = after
        self._watch(progress)
        if after.iteration % run.settings.checkpoint_every == 0:
            self.save()
        return progress

    def save(self) -> None:
        """Write a checkpoint unless it is there already, and delete those that are not kept."""
        if self.saved == self.checkpoint.iteration:
            return
        path = self.run.save_state(self.checkpoint.state, self.checkpoint.environment_steps)
        self.saved = self.checkpoint.iteration
        if self.keep:
            self.run.prune(path, self.keep)

    def _watch(self, progress: Progress) -> None:
        """Say that a step was not finite, and give up after several in a row."""
        broken = [name for name, value in progress.info.items() if not math.isfinite(value)]
        tasks = int(progress.info.get("nonfinite_tasks", 0))
        if progress.find("accepted") or not (broken or tasks):
            self.nonfinite = 0
            return
        self.nonfinite += 1
        what = f"the loss of {tasks} tasks" if tasks else f"`{broken[0]}`"
        said = f"`{self.run.directory}`, iteration {progress.iteration}: {what} is not finite"
        logger.warning("%s. The step was rejected; the policy is as before.", said)
        if self.nonfinite == MAX_NONFINITE:
            raise RunError(
                f"{said}, {MAX_NONFINITE} times in a row: start anew with smaller steps."
            )


def train_live(
    run: Run, iterations: int | None = None, keep: int = KEEP, console: Console | None = None
) -> Progress | None:
    """Train and show how it goes: one live line on a terminal, else one line per iteration.

    Returns the last iteration, None if nothing was left to do. All else is as for `train`.
    """
    console = console or Console()
    # As it is: no markup, no colours, no line breaks of its own.
    say = functools.partial(console.print, markup=False, highlight=False, soft_wrap=True)
    total = run.settings.iterations if iterations is None else iterations
    last: Progress | None = None
    try:
        with (
            ending_by_signals(),
            contextlib.closing(train(run, iterations, keep)) as steps,
            _live_line(console) if console.is_terminal else contextlib.nullcontext(say) as show,
        ):
            for last in steps:
                left = datetime.timedelta(seconds=round(last.seconds * (total - last.iteration)))
                show(f"{last.iteration}/{total}: {describe(last)}, {left} left")
    except (KeyboardInterrupt, SystemExit):
        more = "" if total == run.settings.iterations else f" --iterations {total}"
        with contextlib.suppress(OSError):  # the terminal may be gone
            say(f"Stopped, and saved. To go on: maesn resume {run.typed}{more}")
        raise
    if last is None:
        say(f"{run.directory} has done {run.latest().iteration} iterations: nothing is left.")
    return last


def describe(progress: Progress) -> str:
    """Return one iteration in a line of text."""
    info, parts = progress.info, []
    if "return_before" in info and "return_after" in info:
        parts.append(f"return {info['return_before']:.1f} -> {info['return_after']:.1f}")
    if "success_after" in info:
        parts.append(f"success {info['success_after']:.0%}")
    if (kl := progress.find("kl")) is not None:
        rejected = progress.find("accepted") == 0.0
        parts.append("step rejected" if rejected else f"KL {kl:.4f}")
    for label, name in (("ELBO", "elbo"), ("Q loss", "q")):
        if (value := progress.find(name)) is not None:
            parts.append(f"{label} {value:.2f}")
    parts.append(f"{progress.steps_per_second:,.0f} steps/s")
    return ", ".join(parts)


@contextlib.contextmanager
def _live_line(console: Console) -> Iterator[Callable[[str], None]]:
    """Let a line on a terminal take the place of the one before."""
    # A thread that refreshes it would outlive the terminal.
    live = Live("compiling", console=console, auto_refresh=False)
    live.start()
    try:
        yield lambda line: live.update(Text(line, no_wrap=True, overflow="ellipsis"), refresh=True)
    finally:
        with contextlib.suppress(OSError):  # the terminal may be gone
            live.stop()
