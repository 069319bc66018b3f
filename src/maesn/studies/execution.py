"""Computing the jobs of a plan: in an order that suits, again where one was lost, all or what can.

What is done is on disk; nothing else is remembered. So a study that was killed goes on.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Literal, TypeAlias

from rich.console import Console
from rich.live import Live
from rich.table import Table

from maesn.storage import LOCK, RunError, read_json, write_json
from maesn.studies.executors import AbstractExecutor, Ended
from maesn.studies.jobs import DONE, AbstractJob
from maesn.worlds.budget import STEPS_PER_SECOND

Say: TypeAlias = Callable[[str], None]
Status: TypeAlias = Literal["done", "running", "waiting", "failed"]

FAILED = "failed.json"
_POLL = 1.0  # seconds
_SHOWN = 20  # lines of a terminal


@dataclasses.dataclass
class Execution:
    """The jobs of a plan, in the directory in which they are computed."""

    jobs: Mapping[str, AbstractJob]
    directory: Path
    retries: int = 2
    """How often a job that failed by accident is tried again."""
    failed: dict[str, str] = dataclasses.field(default_factory=dict)
    """Job -> its error."""
    running: dict[str, int] = dataclasses.field(default_factory=dict)
    """Job -> which attempt it is."""

    def run(self, executor: AbstractExecutor, say: Say) -> None:
        """Compute all that can be computed; what fails is in `failed` then."""
        waiting = [job for job in self.jobs.values() if not job.is_done(self.directory)]
        attempts = dict.fromkeys(self.jobs, 0)
        total, done = len(self.jobs), len(self.jobs) - len(waiting)
        if done:
            say(f"{done} of {total} jobs were done before")
        with _shown(self) as show:
            while waiting or self.running:
                for job in self._ready(waiting)[: executor.slots - len(self.running)]:
                    waiting.remove(job)
                    attempts[job.name] += 1
                    self.running[job.name] = attempts[job.name]
                    executor.start(job, self.directory)
                for ended in executor.wait(_POLL):
                    del self.running[ended.job]
                    if not ended.error:
                        done += 1
                        (self.directory / ended.job / FAILED).unlink(missing_ok=True)
                        say(f"{done}/{total} {ended.job}")
                    elif not ended.is_final and attempts[ended.job] <= self.retries:
                        say(f"again: {ended.job}, because {ended.error}")
                        waiting.insert(0, self.jobs[ended.job])
                    else:
                        self._fail(ended, say)
                        waiting = [one for one in waiting if not self._is_lost(one)]
                show()

    def only(self, name: str) -> None:
        """Leave one job, of which those that it needs must be done.

        Raises:
            RunError: there is no such job, or they are not.
        """
        if name not in self.jobs:
            raise RunError(f"the study has no job `{name}`: `--dry-run` lists them.")
        missing = [need for need in self.jobs[name].needs if not self._has(need)]
        if missing:
            raise RunError(f"the job `{name}` needs `{missing[0]}` to be done before.")
        self.jobs = {name: self.jobs[name]}

    def _ready(self, waiting: list[AbstractJob]) -> list[AbstractJob]:
        """Return the jobs that can begin, the longest first: they decide when all is done."""
        ready = [job for job in waiting if all(map(self._has, job.needs))]
        return sorted(ready, key=lambda job: -job.steps)

    def _has(self, name: str) -> bool:
        return (self.directory / name / DONE).exists()

    def _is_lost(self, job: AbstractJob) -> bool:
        """Whether a job needs one that failed."""
        return any(name in self.failed or self._is_lost(self.jobs[name]) for name in job.needs)

    def _fail(self, ended: Ended, say: Say) -> None:
        self.failed[ended.job] = ended.error
        folder = self.directory / ended.job
        if folder.is_dir():
            write_json(folder / FAILED, {"error": ended.error})
        say(f"failed: {ended.job}: {ended.error}")

    def status(self) -> dict[str, tuple[Status, str]]:
        """Return for each job how it is, and a remark: its progress, or its error."""
        return {name: self._status(job) for name, job in self.jobs.items()}

    def _status(self, job: AbstractJob) -> tuple[Status, str]:
        folder = self.directory / job.name
        if job.is_done(self.directory):
            return "done", f"{read_json(folder / DONE)['seconds']:.0f} s"
        if (folder / LOCK).exists():
            return "running", f"{job.progress(folder):.0%}"
        if (folder / FAILED).exists():
            return "failed", str(read_json(folder / FAILED)["error"])
        lost = [name for name in job.needs if not self._has(name)]
        return "waiting", f"for {lost[0]}" if lost else ""

    def left(self, workers: int) -> str:
        """Return a sentence on the time until all is done."""
        minutes = self.seconds_left(workers) / 60
        return f"About {minutes:,.0f} minutes left with {workers} at a time."

    def seconds_left(self, workers: int = 1) -> float:
        """Return an estimate of the time until all is done, by the speed of what is done."""
        done = [read_json(self.directory / name / DONE) for name in self.jobs if self._has(name)]
        steps, seconds = (sum(float(one[key]) for one in done) for key in ("steps", "seconds"))
        speed = steps / seconds if seconds else STEPS_PER_SECOND / 2
        left = [job for job in self.jobs.values() if not job.is_done(self.directory)]
        return sum(job.steps * (1 - job.progress(self.directory / job.name)) for job in left) / (
            speed * workers
        )


@contextlib.contextmanager
def _shown(execution: Execution) -> Iterator[Callable[[], None]]:
    """Yield what shows the jobs that run, a line each, on a terminal; nothing elsewhere."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda: None
        return

    def show() -> None:
        rows = Table.grid(padding=(0, 2))
        for name, attempt in list(execution.running.items())[:_SHOWN]:
            share = execution.jobs[name].progress(execution.directory / name)
            rows.add_row(name, f"{share:.0%}", f"attempt {attempt}" if attempt > 1 else "")
        live.update(rows, refresh=True)

    with Live(console=console, auto_refresh=False, transient=True) as live:
        yield show
