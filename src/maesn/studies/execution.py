"""The jobs of a plan, each computed once: in a good order, and again where a process was lost.

The disk holds all that is done, and nothing else does. So a study that was killed goes on.
"""

import dataclasses
import math
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Set
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import Any, TypeAlias

from maesn.storage import RunError, is_locked, read_json, write_json
from maesn.studies.jobs import DONE, STEPS_PER_SECOND, Job

Say: TypeAlias = Callable[[str], None]

FAILED = "failed.json"
ATTEMPTS = 3  # a job may fail because its process was killed

# A guess for jobs of a kind that has not been computed yet: the start, with compilation.
SECONDS_TO_BEGIN = 10


class AbstractExecutor(ABC):
    """Computes jobs, each with a fixed number of threads."""

    slots: int  # jobs that may run at a time

    @abstractmethod
    def submit(self, job: Job, jobs: Path) -> Future[str | None]:
        """Begin a job, for which there is a slot, in the directory of all jobs.

        The future returns its error, or None. It raises if the process or the machine is lost.
        """

    def describe(self, lost: BaseException) -> str:
        """Say why a process or machine was lost; raise a `RunError` if no process can work."""
        return f"it ended with {lost!r}."

    def close(self) -> None:
        """Stop all jobs; the same jobs go on later."""
        return


@dataclasses.dataclass
class Execution:
    """The jobs of a plan, and the directory in which they are computed."""

    jobs: Mapping[str, Job]
    directory: Path
    joined: Set[str] = frozenset()
    """Jobs whose results are in a table of the study. Their own directories may be gone."""
    failed: dict[str, str] = dataclasses.field(default_factory=dict)
    """Name of a failed job -> its error."""

    def run(self, executor: AbstractExecutor, say: Say) -> None:
        """Compute all jobs except those that need a failed one, and note those that fail."""
        waiting = [job for job in self.jobs.values() if not self.is_done(job.name)]
        waiting.sort(key=lambda job: -job.steps)  # the longest decide when all is done
        total, done = len(self.jobs), len(self.jobs) - len(waiting)
        if done:
            say(f"{done} of {total} jobs were done before")
        running: dict[Future[str | None], Job] = {}
        attempts: Counter[str] = Counter()
        while waiting or running:
            ready = [job for job in waiting if self._can_begin(job)]
            for job in ready[: executor.slots - len(running)]:
                waiting.remove(job)
                attempts[job.name] += 1
                running[executor.submit(job, self.directory)] = job
            if not running:
                time.sleep(1.0)  # another study computes what is left
            # Another process may finish a job that ours wait for.
            timeout = 10.0 if waiting and len(running) < executor.slots else None
            for future in wait(running, timeout, FIRST_COMPLETED).done:
                job, lost = running.pop(future), future.exception()
                error = executor.describe(lost) if lost else future.result()
                if error is None:
                    done += 1
                    (self.directory / job.name / FAILED).unlink(missing_ok=True)
                    say(f"{done}/{total} {job.name}")
                elif attempts[job.name] < ATTEMPTS:
                    say(f"again: {job.name}, because {error}")
                    waiting.insert(0, job)
                else:
                    self.failed[job.name] = error
                    write_json(self.directory / job.name / FAILED, {"error": error})
                    say(f"failed: {job.name}: {error}")
                    waiting = [one for one in waiting if not self._needs_failed(one)]

    def only(self, name: str) -> None:
        """Drop all jobs but one; `RunError` if a job that it needs is not done."""
        if name not in self.jobs:
            raise RunError(f"the study has no job `{name}`: `maesn study status` lists them.")
        missing = [need for need in self.jobs[name].needs if not self.is_done(need)]
        if missing:
            raise RunError(f"the job `{name}` needs `{missing[0]}` to be done before.")
        self.jobs = {name: self.jobs[name]}

    def done(self, name: str) -> dict[str, Any] | None:
        """Return the content of a job's `done.json`; None if it is not done."""
        path = self.directory / name / DONE
        if path.exists():
            return read_json(path)
        return {} if name in self.joined else None

    def is_done(self, name: str) -> bool:
        """Whether a job's directory or a table holds its result."""
        return self.done(name) is not None

    def _can_begin(self, job: Job) -> bool:
        return all(map(self.is_done, job.needs)) and not is_locked(self.directory / job.name)

    def _needs_failed(self, job: Job) -> bool:
        return any(name in self.failed or self._needs_failed(self.jobs[name]) for name in job.needs)

    def status(self, job: Job) -> tuple[str, str]:
        """Return `done`, `running`, `failed` or `waiting`, and a remark."""
        folder = self.directory / job.name
        if (done := self.done(job.name)) is not None:
            return "done", f"{done['seconds']:.0f} s" if done else ""
        if is_locked(folder):
            return "running", f"{job.progress(folder):.0%}"
        if (folder / FAILED).exists():
            return "failed", str(read_json(folder / FAILED)["error"])
        return "waiting", ""

    def hours_left(self, names: Iterable[str]) -> float:
        """Return the estimate for jobs and all that they need, as far as they are not done."""
        done = self._found()
        wanted, counted = [*names], set[str]()
        while wanted:
            if (name := wanted.pop()) not in counted and name not in done:
                counted.add(name)
                wanted += self.jobs[name].needs
        return sum(self._seconds_left(self.jobs[name], done)[0] for name in counted) / 3600

    def _found(self) -> dict[str, dict[str, Any]]:
        return {name: found for name in self.jobs if (found := self.done(name)) is not None}

    def left(self, workers: int) -> str:
        """Return a sentence with an estimate of the time left, and what it rests on."""
        done = self._found()
        seconds, ends = 0.0, dict.fromkeys(done, 0.0)
        rests_on = dict[str, None]()
        for job in self.jobs.values():
            if job.name not in done:
                own, basis = self._seconds_left(job, done)
                rests_on[basis] = None
                seconds += own
                before = (ends.get(name, 0.0) for name in job.needs)
                ends[job.name] = own + max(before, default=0.0)
        if not rests_on:
            return "All jobs are done."
        minutes = math.ceil(max(seconds / workers, *ends.values()) / 60)
        left = f"{minutes / 60:,.0f} hours" if minutes > 180 else f"{minutes} min"
        return f"About {left} left with {workers} at a time, by {' and '.join(rests_on)}."

    def _took(self, job: Job, done: Mapping[str, Mapping[str, Any]]) -> tuple[float, float]:
        """Return the guess for what is done of a job, and what it took, in seconds."""
        if found := done.get(job.name):
            return job.seconds * found["steps"] / max(job.steps, 1), float(found["seconds"])
        return job.spent(self.directory / job.name)

    def _seconds_left(self, job: Job, done: Mapping[str, Mapping[str, Any]]) -> tuple[float, str]:
        """Return the estimate for what is left of a job, and what it rests on.

        A training that has begun counts alone; otherwise all jobs of its kind count.
        """
        directory = self.directory / job.name
        left = 1 - job.progress(directory)
        guessed, took = job.spent(directory)
        if guessed:
            return left * job.seconds * took / guessed, "what begun trainings took so far"
        kind = job.name.split("-")[:2]
        like = [one for one in self.jobs.values() if one.name.split("-")[:2] == kind]
        guessed, took = map(sum, zip(*(self._took(one, done) for one in like), strict=True))
        if guessed:
            return left * job.seconds * took / guessed, "what jobs of the same kind took"
        return (
            left * (SECONDS_TO_BEGIN + job.seconds),
            f"{SECONDS_TO_BEGIN} seconds to begin a job and {STEPS_PER_SECOND:,} steps per second, "
            "as on `point` and `wheeled`, or fewer where a method learns more from each",
        )
