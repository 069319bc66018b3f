"""Computing the jobs of a plan: in an order that suits, again where one was lost, all or what can.

What is done is on disk; nothing else is remembered. So a study that was killed goes on.
"""

import dataclasses
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import Literal, TypeAlias

from rich.console import Console
from rich.live import Live
from rich.table import Table

from maesn.storage import LOCK, RunError, read_json, write_json
from maesn.studies.executors import AbstractExecutor, Failure, accident
from maesn.studies.jobs import DONE, AbstractJob, is_done
from maesn.worlds.budget import STEPS_PER_SECOND

Say: TypeAlias = Callable[[str], None]
Status: TypeAlias = Literal["done", "running", "waiting", "failed"]

FAILED = "failed.json"
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

    def __post_init__(self) -> None:
        self._running: dict[Future[Failure | None], AbstractJob] = {}
        self._attempts: Counter[str] = Counter()

    def run(self, executor: AbstractExecutor, say: Say) -> None:
        """Compute all that can be computed; what fails is in `failed` then."""
        waiting = [job for job in self.jobs.values() if not self._has(job.name)]
        total, done = len(self.jobs), len(self.jobs) - len(waiting)
        if done:
            say(f"{done} of {total} jobs were done before")
        console = Console(stderr=True)
        with Live(
            console=console,
            get_renderable=self._shown,
            auto_refresh=console.is_terminal,
            refresh_per_second=1,
            transient=True,
        ):
            while waiting or self._running:
                for job in self._ready(waiting)[: executor.slots - len(self._running)]:
                    waiting.remove(job)
                    self._attempts[job.name] += 1
                    self._running[executor.submit(job, self.directory)] = job
                for future in wait(self._running, return_when=FIRST_COMPLETED).done:
                    job, error = self._running.pop(future), future.exception()
                    failure = accident(error) if error else future.result()
                    if failure is None:
                        done += 1
                        (self.directory / job.name / FAILED).unlink(missing_ok=True)
                        say(f"{done}/{total} {job.name}")
                    elif not failure.is_final and self._attempts[job.name] <= self.retries:
                        say(f"again: {job.name}, because {failure.error}")
                        waiting.insert(0, job)
                    else:
                        self._fail(job.name, failure.error, say)
                        waiting = [one for one in waiting if not self._is_lost(one)]

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
        return is_done(name, self.directory)

    def _is_lost(self, job: AbstractJob) -> bool:
        """Whether a job needs one that failed."""
        return any(name in self.failed or self._is_lost(self.jobs[name]) for name in job.needs)

    def _fail(self, job: str, error: str, say: Say) -> None:
        self.failed[job] = error
        if (self.directory / job).is_dir():
            write_json(self.directory / job / FAILED, {"error": error})
        say(f"failed: {job}: {error}")

    def _shown(self) -> Table:
        """Return what a terminal shows: the jobs that run, a line each."""
        rows = Table.grid(padding=(0, 2))
        for job in list(self._running.values())[:_SHOWN]:
            attempt = self._attempts[job.name]
            again = f"attempt {attempt}" if attempt > 1 else ""
            rows.add_row(job.name, f"{job.progress(self.directory / job.name):.0%}", again)
        return rows

    def status(self, job: AbstractJob) -> tuple[Status, str]:
        """Return how a job is, and a remark: its progress, or its error."""
        folder = self.directory / job.name
        if self._has(job.name):
            return "done", f"{read_json(folder / DONE)['seconds']:.0f} s"
        if (folder / LOCK).exists():
            return "running", f"{job.progress(folder):.0%}"
        if (folder / FAILED).exists():
            return "failed", str(read_json(folder / FAILED)["error"])
        lost = [name for name in job.needs if not self._has(name)]
        return "waiting", f"for {lost[0]}" if lost else ""

    def left(self, workers: int) -> str:
        """Return a sentence on the time until all is done, by the speed of what is done."""
        done = [read_json(self.directory / name / DONE) for name in self.jobs if self._has(name)]
        steps, seconds = (sum(float(one[key]) for one in done) for key in ("steps", "seconds"))
        speed = steps / seconds if seconds else STEPS_PER_SECOND / 2
        missing = sum(
            job.steps * (1 - job.progress(self.directory / job.name))
            for job in self.jobs.values()
            if not self._has(job.name)
        )
        minutes = missing / speed / workers / 60
        return f"About {minutes:,.0f} minutes left with {workers} at a time."
