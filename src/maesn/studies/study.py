"""A study: any comparison, from what a file says to figures and tables."""

import contextlib
import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from maesn.reporting.reading import latents_beside, read_rows
from maesn.reporting.study import MANIFEST, RESULTS, report_study
from maesn.reporting.tables import TextTable
from maesn.runs.config import installed_versions
from maesn.runs.signals import ending_by_signals
from maesn.settings import check_number
from maesn.storage import (
    explained,
    locked,
    read_arrays,
    read_json,
    refusals,
    write_arrays,
    write_json,
    write_rows,
    write_whole,
)
from maesn.studies.execution import (
    AbstractExecutor,
    Execution,
    ExecutorName,
    LocalPool,
    Ray,
    Say,
)
from maesn.studies.jobs import DONE, EXPLORATION, LATENTS, ROWS
from maesn.studies.plan import Entry, make_plan
from maesn.studies.reading import read_study
from maesn.studies.spec import StudySpec

JOBS = "jobs"


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
            self.write_results(execution, directory)
            tables = report_study(directory, lambda path: say(str(path)))
            return Results(directory, tables, execution.failed)

    def execution(self, out: str | Path, retries: int = 2) -> Execution:
        """Return the jobs and their state in a directory."""
        return Execution(self.plan.jobs, Path(out) / JOBS, retries)

    def write_results(self, execution: Execution, directory: Path) -> None:
        """Write what is done: a table for each line and seed, and the manifest that names them.

        `maesn.reporting.study` reads these files, and nothing else.
        """
        document = {
            "study": self.spec.name,
            "comparisons": [_collect(one, execution, directory) for one in self.plan.comparisons],
            "figures": [dataclasses.asdict(one) for one in self.spec.figures],
            "jobs": sorted(self.plan.jobs),
            "versions": installed_versions("mujoco.batch"),
        }
        write_json(directory / MANIFEST, document)


def _collect(comparison: Entry, execution: Execution, directory: Path) -> Entry:
    """Write the tables of a comparison; return it with those lines and seeds that are done.

    A study that was pruned has the files of jobs no more: its tables stay as they are.
    """
    recorded = {}
    for name, job in comparison["recorded"].items():
        if execution.is_done(job):
            recorded[name] = f"recorded/{comparison['name']}/{name}.npz"
            path = execution.directory / job / EXPLORATION
            if path.exists():
                write_whole(directory / recorded[name], path.read_bytes())
    found = comparison | {"recorded": recorded}
    for kind in ("lines", "baselines", "oracle"):
        lines = [_line(line, comparison["name"], execution, directory) for line in comparison[kind]]
        found[kind] = [line for line in lines if line["seeds"]]
    return found


def _line(line: Entry, comparison: str, execution: Execution, directory: Path) -> Entry:
    """Return a line with the seeds that are done, each with a table of all its tasks."""
    jobs, seeds = execution.directory, []
    for member, parts in line["seeds"]:
        if all(map(execution.is_done, parts)):
            table = f"tables/{comparison}/{line['name']}-seed-{member.seed}.csv.gz"
            _join([jobs / job for job in parts], directory / table)
            steps = member.training_steps
            if member.job:
                steps = read_json(jobs / member.job / DONE)["environment_steps"]
            seeds.append({"seed": member.seed, "table": table, "training_steps": steps})
    return line | {"seeds": seeds}


def _join(jobs: Sequence[Path], table: Path) -> None:
    """Write a table of all tasks; beside it the adapted latents, where jobs have kept them."""
    if not all((job / ROWS).exists() for job in jobs):
        return
    write_rows(table, [row for job in jobs for row in read_rows(job / ROWS)])
    latents = latents_beside(table)
    if all((job / LATENTS).exists() for job in jobs):
        parts = [read_arrays(job / LATENTS, "compute it again") for job in jobs]
        joined = {x: np.concatenate([part[x] for part in parts]) for x in ("mean", "log_std")}
        write_arrays(latents, parts[0] | joined)
    else:
        latents.unlink(missing_ok=True)  # what the line had before its evaluation was changed
