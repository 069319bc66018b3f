"""Studies: any comparison, from what a file says to figures and tables; those of runs in memory."""

import contextlib
import dataclasses
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import tyro

from maesn import storage
from maesn.evaluation.arguments import AnyPath, AnyRun, OptionalPath
from maesn.evaluation.evaluation import USUAL, AnyEvaluation
from maesn.learners import SCRATCH
from maesn.reporting.reading import latents_beside, read_rows
from maesn.reporting.report import report_study
from maesn.reporting.runs import read_run
from maesn.reporting.sources import MANIFEST, group_series, joined_files
from maesn.reporting.tables import TextTable
from maesn.runs.config import RunSettings, installed_versions
from maesn.runs.process import ending_by_signals
from maesn.runs.run import Run
from maesn.settings import check_number
from maesn.storage import RunError
from maesn.studies.execution import (
    AbstractExecutor,
    Execution,
    ExecutorName,
    LocalPool,
    Ray,
    Say,
    end_if_worker,
)
from maesn.studies.jobs import EXPLORATION, LATENTS, ROWS
from maesn.studies.members import trained_run
from maesn.studies.plan import Entry, make_plan
from maesn.studies.reading import read_study
from maesn.studies.spec import EvaluationSpec, LineSpec, RunSpec, ScratchSpec, StudySpec

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
        executor: ExecutorName | AbstractExecutor = "local",
        workers: int | None = None,
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
            if executor == "local":
                executor = LocalPool(at_once, self.spec.threads)
            elif executor == "ray":
                executor = Ray(at_once, self.spec.threads, execution.directory)
            with contextlib.closing(executor):
                say(execution.left(executor.slots))
                execution.run(executor, say)
            tables: list[TextTable] = []
            if only is None:
                self.write_results(out)
                tables = report_study(directory, lambda path: say(str(path)))
        results = Results(directory, tables)
        if execution.failed:
            raise FailedJobsError(execution.failed, results)
        return results

    def workers(self, asked: int | None) -> int:
        """Return how many jobs run at a time; None: as many as there are CPUs for."""
        with storage.refusals():
            check_number("workers", asked, 1)
        return asked or max(1, len(os.sched_getaffinity(0)) // self.spec.threads)

    def write_results(self, out: str | Path) -> None:
        """Write tables of what is done, and the manifest that names them, for the report."""
        execution, directory = self.execution(out), Path(out) / self.spec.name
        document = {
            "study": self.spec.name,
            "comparisons": [_collect(one, execution, directory) for one in self.comparisons],
            "figures": [dataclasses.asdict(one) for one in self.spec.figures],
            "jobs": sorted(self.jobs),
            "files": {x: jobs for x, jobs in self.files() if all(map(execution.is_done, jobs))},
            "versions": installed_versions("mujoco.batch"),
        }
        storage.write_json(directory / MANIFEST, document)

    def files(self) -> Iterator[tuple[str, list[str]]]:
        """Yield each file that the report reads, with the jobs whose results it joins."""
        for comparison in self.comparisons:
            name = comparison["name"]
            for source, job in comparison["recorded"].items():
                yield _recorded(name, source), [job]
            for line in (line for group in _GROUPS for line in comparison[group]):
                for member, parts in line["seeds"]:
                    yield _table(name, line, member.seed), parts

    def execution(self, out: str | Path) -> Execution:
        """Return the jobs and their state in a directory."""
        there, files = joined_files(Path(out) / self.spec.name), dict(self.files())
        missing = {job for name, jobs in files.items() if there.get(name) != jobs for job in jobs}
        return Execution(self.jobs, Path(out) / JOBS, {*chain(*files.values())} - missing)


_GROUPS = ("lines", "baselines", "oracle")


def _table(comparison: str, line: Entry, seed: int) -> str:
    return f"tables/{comparison}/{line['name']}-seed-{seed}.csv.gz"


def _recorded(comparison: str, source: str) -> str:
    return f"recorded/{comparison}/{source}.npz"


def _collect(comparison: Entry, execution: Execution, directory: Path) -> Entry:
    """Write the tables of a comparison; return it with those lines and seeds that are done.

    A study that was pruned has the files of jobs no more: its tables stay as they are.
    """
    recorded = {}
    for name, job in comparison["recorded"].items():
        if execution.is_done(job):
            recorded[name] = _recorded(comparison["name"], name)
            if (path := execution.directory / job / EXPLORATION).exists():
                storage.write_whole(directory / recorded[name], path.read_bytes())
    found = comparison | {"recorded": recorded}
    for group in _GROUPS:
        lines = [_line(x, comparison["name"], execution, directory) for x in comparison[group]]
        found[group] = [line for line in lines if line["seeds"]]
    return found


def _line(line: Entry, comparison: str, execution: Execution, directory: Path) -> Entry:
    """Return a line with the seeds that are done, each with a table of all its tasks."""
    jobs, seeds = execution.directory, []
    for member, parts in line["seeds"]:
        trained = [execution.done(job) or {} for job in member.needs]
        if all(trained) and all(map(execution.is_done, parts)):
            table = _table(comparison, line, member.seed)
            _join([jobs / job for job in parts], directory / table)
            steps = trained[0]["environment_steps"] if trained else member.training_steps
            seeds.append({"seed": member.seed, "table": table, "training_steps": steps})
    return line | {"seeds": seeds}


def _join(jobs: Sequence[Path], table: Path) -> None:
    """Write a table of all tasks; beside it the adapted latents, where jobs have kept them."""
    if not all((job / ROWS).exists() for job in jobs):
        return
    storage.write_rows(table, [row for job in jobs for row in read_rows(job / ROWS)])
    latents = latents_beside(table)
    if all((job / LATENTS).exists() for job in jobs):
        parts = [storage.read_arrays(job / LATENTS, "compute it again") for job in jobs]
        joined = {x: np.concatenate([part[x] for part in parts]) for x in ("mean", "log_std")}
        storage.write_arrays(latents, parts[0] | joined)
    else:
        latents.unlink(missing_ok=True)  # what the line had before its evaluation was changed


def compare(
    runs: tyro.conf.Positional[Sequence[AnyRun]] = (),
    *,
    out: AnyPath = Path("comparison"),
    scratch: Sequence[str] = (),
    oracle: OptionalPath = None,
    family: str | None = None,
    method: str | None = None,
    workers: int | None = None,
    evaluation: AnyEvaluation = USUAL,
    executor: Annotated[ExecutorName | AbstractExecutor, tyro.conf.Suppress] = "local",
    say: Annotated[Say, tyro.conf.Suppress] = lambda sentence: None,
) -> Results:
    """Adapt trained runs and methods from scratch to the same tasks, and compare them.

    With `--rule`, `--then` or `--bonus`, every run that can be given it takes part a second time
    with it. For anything else write a study (`maesn study run`).

    Args:
        runs: Directories of trained runs; those that differ in their seed alone become one line.
        out: Directory of figure, tables and jobs; what was interrupted goes on there.
        scratch: Methods that begin anew in every task: trpo, reinforce (alias vpg), vime.
            NAME:COUNT adapts to the first COUNT tasks alone, as in vime:30.
        oracle: Directory of a run of the preset `oracle`, the upper end of the score.
        family: Of the tasks, where there are no runs; or `module:name` of the runs' own.
        method: The runs' method as `module:name`, if it is your own.
        workers: Tasks at a time, in chunks; None: as many as there are CPUs for.
        evaluation: of all lines; its seed is also that of methods from scratch.
        executor: where it is computed; see `Study.run`.
        say: receives messages of progress.

    Raises:
        FailedJobsError: some jobs failed; all others are done.
        RunError: a setting, a run or a directory cannot be used.
    """
    if not (runs or scratch):
        raise RunError("name at least one run directory, or a method with --scratch.")
    opened = {run.directory: run for run in [Run.open(one, family, method) for one in runs]}
    if family is None and not opened:
        raise RunError("`family` must be given where no run says it: --family NAME.")
    with storage.refusals("each run takes part without `--rule` as well, for which "):
        usual = dataclasses.replace(evaluation, rule=None, wrappers=())
    evaluations = {"usual": EvaluationSpec(usual)}
    specs, lines, more = {}, [], []
    for one in group_series([read_run(path) for path in opened]):
        paths = [run.path for run in one.runs]
        specs[one.name] = RunSpec(label=one.style.label, directories=tuple(map(str, paths)))
        lines.append(LineSpec(run=one.name, evaluation=("usual",)))
        if evaluation.rule is not None or evaluation.wrappers:
            evaluations["more"] = EvaluationSpec(evaluation)
            try:
                trained_run(opened[paths[0]]).trial_episodes(evaluation)
                more.append(LineSpec(run=one.name, evaluation=("more",)))
            except RunError as error:
                say(f"{one.name} takes part as it is: {error}")
    from_scratch = dict(map(_scratch, scratch))
    if len(from_scratch) < len(scratch):
        raise RunError("`scratch` must name each method once.")
    lines += [*more, *(LineSpec(scratch=name, evaluation=("usual",)) for name in from_scratch)]
    if oracle is not None:
        preset = Run.open(oracle, family).settings.method
        if preset != "oracle" or "oracle" in specs:
            raise RunError(f"`oracle` must be the only run of the method `oracle`, got `{preset}`.")
        specs["oracle"] = RunSpec(directories=(str(oracle),))
    spec = StudySpec(
        name="comparison",
        file="compare",
        families=(family or _common("family", opened.values()),),
        seeds=(evaluation.seed,),
        variant=_common("variant", opened.values()),
        engine=evaluation.engine or _common("engine", opened.values()),
        evaluation_seed=evaluation.seed,
        threads=evaluation.num_threads or 1,
        oracle="" if oracle is None else "oracle",
        runs=specs,
        evaluations=evaluations,
        scratch=from_scratch,
        lines=tuple(lines),
    )
    return Study(spec).run(out, executor=executor, workers=workers, say=say)


def _common(name: str, runs: Iterable[Run]) -> Any:
    """Return a setting of the world that all runs must have in common."""
    found = {getattr(run.settings, name) for run in runs}
    if len(found) > 1:
        raise RunError(f"the runs must agree in `{name}`, got {' and '.join(sorted(found))}.")
    return next(iter(found), getattr(RunSettings(), name))


def _scratch(text: str) -> tuple[str, ScratchSpec]:
    """Read NAME or NAME:COUNT."""
    name, _, count = text.partition(":")
    if name not in SCRATCH or not (count or "1").isdecimal():
        known = f"one of {', '.join(SCRATCH)}, perhaps as in vime:30"
        raise RunError(f"`scratch` must be {known}, got `{text}`.")
    method = SCRATCH[name].__name__
    with storage.refusals():
        return method, ScratchSpec(method, num_tasks=int(count) if count else None)
