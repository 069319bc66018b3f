"""Studies: any comparison, from what a file says to figures and tables."""

import contextlib
from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from maesn import storage
from maesn.reporting.report import write_report
from maesn.reporting.sources import compare_study, joined_files
from maesn.reporting.tables import TextTable
from maesn.runs.process import ending_by_signals
from maesn.settings import check_number
from maesn.storage import RunError
from maesn.studies.execution import AbstractExecutor, Execution, Say
from maesn.studies.executors import LocalPool, end_if_worker
from maesn.studies.manifest import files_of, write_manifest
from maesn.studies.plan import make_plan
from maesn.studies.reading import read_study
from maesn.studies.spec import StudySpec
from maesn.worlds.budget import num_cpus

JOBS = "jobs"


class Results(NamedTuple):
    """What a study has computed."""

    directory: Path
    """Directory of manifest, figures and tables; `results.csv` holds all results."""
    tables: list[TextTable]
    """Tables of where each method ends, and who beats whom."""


class FailedJobsError(RunError):
    """Some jobs of a study failed. All that do not need them are done.

    Attributes:
        failed: name of each failed job -> its error.
        results: what the study has computed all the same.
    """

    def __init__(self, failed: Mapping[str, str], results: Results) -> None:
        name, error = next(iter(failed.items()))
        also = f", and {len(failed) - 1} more" if len(failed) > 1 else ""
        super().__init__(
            f"the job `{name}` failed{also}: {error.rstrip('.')}. All jobs that do not need what "
            "failed are done; the same command tries again."
        )
        self.failed, self.results = failed, results


class Study:
    """A comparison that can be computed, all at once or job by job, here or on a cluster."""

    def __init__(self, spec: StudySpec) -> None:
        """Plan it; `RunError` if something in it cannot be, before anything has run."""
        self.spec = spec
        self.jobs, self.comparisons = make_plan(spec)

    @classmethod
    def load(cls, source: str | Path) -> "Study":
        """Read a study, as `read_study` does, and plan it."""
        return cls(read_study(source))

    def run(
        self,
        out: str | Path,
        *,
        executor: AbstractExecutor | None = None,
        workers: int | None = None,
        only: str | None = None,
        say: Say = lambda sentence: None,
    ) -> Results:
        """Compute what is not done yet, and write figures and tables.

        What another study has computed in `out` is not repeated. A study that was interrupted in
        any way goes on with the same call.

        Args:
            out: directory of jobs and results.
            executor: computes the jobs; None: processes of this machine. It is closed at the end.
            workers: such processes at a time; None: as many as there are CPUs for.
            only: name of the one job to compute, if those that it needs are done.
            say: receives messages of progress.

        Raises:
            FailedJobsError: some jobs failed; all others are done.
            RunError: `out` cannot be used, or no job can begin.
        """
        end_if_worker()
        execution, directory = self.execution(out), Path(out) / self.spec.name
        for folder in (execution.directory, directory):
            with storage.explained("make", folder):
                folder.mkdir(parents=True, exist_ok=True)
        if only is not None:
            execution.only(only)
        at_once = self.workers(workers)
        with contextlib.nullcontext() if only else storage.locked(directory), ending_by_signals():
            if only is None:
                self.write_results(out)  # for those who ask meanwhile what there is
            executor = executor or LocalPool(at_once, self.spec.threads)
            with contextlib.closing(executor):
                say(execution.left(executor.slots))
                execution.run(executor, say)
            tables: list[TextTable] = []
            if only is None:
                self.write_results(out)
                files, tables = write_report(compare_study(directory), directory)
                for path in files:
                    say(str(path))
        results = Results(directory, tables)
        if execution.failed:
            raise FailedJobsError(execution.failed, results)
        return results

    def workers(self, asked: int | None) -> int:
        """Return how many jobs run at a time; None: as many as there are CPUs for."""
        with storage.refusals():
            check_number("workers", asked, 1)
        return asked or max(1, num_cpus() // self.spec.threads)

    def write_results(self, out: str | Path) -> None:
        """Write tables of what is done, and the manifest that names them, for the report."""
        directory = Path(out) / self.spec.name
        write_manifest(self.spec, self.comparisons, self.execution(out), directory)

    def execution(self, out: str | Path) -> Execution:
        """Return the jobs and their state in a directory."""
        there, files = joined_files(Path(out) / self.spec.name), files_of(self.comparisons)
        missing = {job for name, jobs in files.items() if there.get(name) != jobs for job in jobs}
        return Execution(self.jobs, Path(out) / JOBS, {*chain(*files.values())} - missing)
