"""A study: any comparison, from what a file says to figures and tables."""

import contextlib
import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from maesn.reporting.reading import latents_beside, read_rows
from maesn.reporting.report import RESULTS, report_study
from maesn.reporting.runs import Latents, read_record
from maesn.reporting.sources import MANIFEST
from maesn.reporting.tables import TextTable
from maesn.runs.config import installed_versions
from maesn.runs.signals import ending_by_signals
from maesn.settings import check_number
from maesn.storage import (
    explained,
    locked,
    read_json,
    refusals,
    write_arrays,
    write_json,
    write_rows,
    write_whole,
)
from maesn.studies.execution import Execution, Say
from maesn.studies.executors import AbstractExecutor, ExecutorName, LocalPool, Ray
from maesn.studies.jobs import DONE, EXPLORATION, LATENTS, ROWS, is_done
from maesn.studies.plan import Entry, make_plan
from maesn.studies.reading import read_study
from maesn.studies.spec import StudySpec

JOBS = "jobs"
_KINDS = ("lines", "baselines", "oracle")  # of lines, in a comparison


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
        self.plan = make_plan(spec)

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
        say: Say = lambda sentence: None,
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
        threads = self.spec.threads
        at_once = workers or max(1, len(os.sched_getaffinity(0)) // threads)
        with contextlib.nullcontext() if only else locked(directory), ending_by_signals():
            if executor == "local":
                executor = LocalPool(at_once, threads)
            elif executor == "ray":
                executor = Ray(at_once, threads, execution.directory)
            with contextlib.closing(executor):
                say(execution.left(executor.slots))
                execution.run(executor, say)
            if only is not None:
                return Results(directory, [], execution.failed)
            self.write_results(Path(out))
            tables = report_study(directory, lambda path: say(str(path)))
            return Results(directory, tables, execution.failed)

    def execution(self, out: str | Path, retries: int = 2) -> Execution:
        """Return the jobs and their state in a directory."""
        return Execution(self.plan.jobs, Path(out) / JOBS, retries)

    def write_results(self, out: Path) -> None:
        """Write what is done: a table for each line and seed, and the manifest that names them.

        `maesn.reporting.sources` reads these files, and nothing else.
        """
        document = {
            "study": self.spec.name,
            "comparisons": [
                one
                | {kind: self._done(one[kind], one["name"], out) for kind in _KINDS}
                | {"recorded": self._recorded(one["recorded"], one["name"], out)}
                for one in self.plan.comparisons
            ],
            "figures": [dataclasses.asdict(one) for one in self.spec.figures],
            "jobs": sorted(self.plan.jobs),
            "versions": installed_versions("mujoco.batch"),
        }
        write_json(out / self.spec.name / MANIFEST, document)

    def _recorded(self, made: Mapping[str, str], comparison: str, out: Path) -> dict[str, str]:
        """Keep what was recorded of runs; return the files by the runs' names."""
        jobs, directory, found = out / JOBS, out / self.spec.name, {}
        for name, job in made.items():
            if is_done(job, jobs):
                found[name] = f"recorded/{comparison}/{name}.npz"
                if (jobs / job / EXPLORATION).exists():
                    write_whole(directory / found[name], (jobs / job / EXPLORATION).read_bytes())
        return found

    def _done(self, lines: list[Entry], comparison: str, out: Path) -> list[Entry]:
        """Return the lines with those seeds that are done, each with a table of all its tasks."""
        jobs, directory, found = out / JOBS, out / self.spec.name, []
        for line in lines:
            seeds = []
            for member, parts in line["seeds"]:
                if all(is_done(job, jobs) for job in parts):
                    table = f"tables/{comparison}/{line['name']}-seed-{member.seed}.csv.gz"
                    # A study that was pruned has its tables alone.
                    if all((jobs / job / ROWS).exists() for job in parts):
                        rows = [row for job in parts for row in read_rows(jobs / job / ROWS)]
                        write_rows(directory / table, rows)
                        _join_latents([jobs / job for job in parts], directory / table)
                    steps = member.training_steps
                    if member.job:
                        steps = read_json(jobs / member.job / DONE)["environment_steps"]
                    seeds.append({"seed": member.seed, "table": table, "training_steps": steps})
            found += [line | {"seeds": seeds}] if seeds else []
        return found


def _join_latents(jobs: Sequence[Path], table: Path) -> None:
    """Put the adapted latents of all tasks beside their table, where jobs have kept them."""
    path = latents_beside(table)
    if not all((job / LATENTS).exists() for job in jobs):
        with explained("remove", path):
            path.unlink(missing_ok=True)  # what the line had before its evaluation was changed
        return
    parts = [read_record(Latents, job / LATENTS, "compute it again") for job in jobs]
    mean, log_std = (
        np.concatenate([getattr(part, name) for part in parts]).astype(np.float32)
        for name in ("mean", "log_std")
    )
    write_arrays(path, vars(Latents(mean, log_std, parts[0].first_update)))
