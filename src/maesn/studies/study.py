"""A study: any comparison, from what a file says to figures and tables."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from maesn.reporting.study import RESULTS, report_study
from maesn.reporting.tables import TextTable
from maesn.runs.signals import ending_by_signals
from maesn.settings import check_number
from maesn.storage import explained, locked, refusals
from maesn.studies.execution import Execution, Say
from maesn.studies.executors import AbstractExecutor, ExecutorName, LocalPool, Ray
from maesn.studies.plan import Plan, make_plan
from maesn.studies.reading import read_study
from maesn.studies.results import write_results
from maesn.studies.spec import StudySpec

JOBS = "jobs"


def silent(sentence: str) -> None:
    """Print nothing."""


class Results(NamedTuple):
    """What a study has computed."""

    directory: Path
    """Of manifest, tables and figures."""
    tables: list[TextTable]
    """Where each method ends, and who beats whom."""
    failed: dict[str, str]
    """Job -> its error."""

    @property
    def csv(self) -> Path:
        """The table of all results, a row per method, seed, task and update: for pandas."""
        return self.directory / RESULTS


class Study:
    """A comparison that can be computed, all at once or job by job, here or on a cluster."""

    def __init__(self, spec: StudySpec) -> None:
        """Plan it; `RunError` if something in it cannot be, before anything has run."""
        self.spec = spec
        self.plan: Plan = make_plan(spec)

    @classmethod
    def load(cls, source: str | Path) -> "Study":
        """Read a study: a path, else the name of one that comes with the library.

        Raises:
            RunError: it cannot be read, or something in it cannot be, with its key.
        """
        return cls(read_study(source))

    def run(
        self,
        out: str | Path,
        *,
        executor: ExecutorName | AbstractExecutor = "local",
        workers: int | None = None,
        retries: int = 2,
        only: str | None = None,
        say: Say = silent,
    ) -> Results:
        """Compute what is not done yet, and write figures and tables.

        What another study has computed in `out` is not repeated. A study that was interrupted in
        any way goes on with the same call.

        Args:
            out: directory of jobs and results.
            executor: where jobs are computed.
            workers: jobs at a time; None: as many as there are CPUs for.
            retries: how often a job that failed by accident is tried again.
            only: name of the one job to compute, if those that it needs are done.
            say: receives messages of progress.

        Raises:
            RunError: the directory cannot be used, or there is no such job.
        """
        with refusals():
            check_number("workers", workers, 1)
            check_number("retries", retries, 0)
        execution, directory = self.execution(out, retries), Path(out) / self.spec.name
        for folder in (execution.directory, directory):
            with explained("make", folder):
                folder.mkdir(parents=True, exist_ok=True)
        if only is not None:
            execution.only(only)
        place = contextlib.nullcontext() if only else locked(directory)
        with place, ending_by_signals():
            with self._opened(executor, workers, execution.directory) as opened:
                say(execution.left(opened.slots))
                execution.run(opened, say)
            if only is not None:
                return Results(directory, [], execution.failed)
            write_results(self.plan, execution.directory, directory)
            return Results(
                directory, report_study(directory, lambda path: say(str(path))), execution.failed
            )

    def execution(self, out: str | Path, retries: int = 2) -> Execution:
        """Return the jobs and their state in a directory."""
        return Execution(self.plan.jobs, Path(out) / JOBS, retries)

    @contextlib.contextmanager
    def _opened(
        self, executor: ExecutorName | AbstractExecutor, workers: int | None, jobs: Path
    ) -> Iterator[AbstractExecutor]:
        threads = self.spec.threads
        at_once = workers or max(1, len(os.sched_getaffinity(0)) // threads)
        if executor == "local":
            executor = LocalPool(at_once, threads)
        elif executor == "ray":
            executor = Ray(at_once, threads, jobs)
        assert isinstance(executor, AbstractExecutor)
        with contextlib.closing(executor):
            yield executor
