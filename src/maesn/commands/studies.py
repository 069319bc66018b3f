"""Commands that compare: studies, and runs that exist."""

from pathlib import Path

import tyro

from maesn.commands.options import command
from maesn.evaluation.arguments import AnyEvaluation, Flag
from maesn.evaluation.evaluation import USUAL
from maesn.reporting.tables import TextTable, print_tables
from maesn.storage import RunError
from maesn.studies.comparison import compare as compare_runs
from maesn.studies.execution import Execution
from maesn.studies.executors import ExecutorName
from maesn.studies.reading import shipped_studies
from maesn.studies.study import Results, Study


def _run(
    file: tyro.conf.Positional[str],
    *,
    out: Path = Path("studies"),
    executor: ExecutorName = "local",
    workers: int | None = None,
    retries: int = 2,
    only: str | None = None,
    dry_run: Flag = False,
) -> None:
    """Compute a study: train, adapt, compare. What was interrupted goes on with the same command.

    Args:
        file: A .toml file, or the name of a study that comes with the library.
        out: Directory of jobs and results; studies there share jobs.
        executor: local: processes of this machine. ray: the cluster of RAY_ADDRESS, else one here.
        workers: Jobs at a time; None: as many as there are CPUs for.
        retries: How often a job that failed by accident is tried again.
        only: The one job to compute, as a job of an array does.
        dry_run: List the jobs with their steps and an estimate of the time; compute nothing.
    """
    study = Study.load(file)
    if dry_run:
        _list(study.execution(out), workers or 1)
        return
    done = study.run(out, executor=executor, workers=workers, retries=retries, only=only, say=print)
    print_tables(done.tables)
    _check(done)


def _status(
    file: tyro.conf.Positional[str], *, out: Path = Path("studies"), workers: int = 1
) -> None:
    """Show how the jobs of a study are: done, running, waiting or failed, and the time left.

    Args:
        file: As for `maesn study run`.
        out: Its directory.
        workers: Jobs at a time, for the estimate.
    """
    execution = Study.load(file).execution(out)
    states = execution.status()
    table = TextTable(
        "Jobs",
        ("job", "status", ""),
        tuple((name, *state) for name, state in states.items()),
        (execution.left(workers),),
    )
    print_tables([table])


@command
def compare(
    runs: tyro.conf.Positional[tuple[Path, ...]] = (),
    *,
    out: Path = Path("comparison"),
    scratch: tuple[str, ...] = (),
    oracle: Path | None = None,
    family: str | None = None,
    workers: int | None = None,
    evaluation: AnyEvaluation = USUAL,
) -> None:
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
        workers: Tasks at a time, in chunks; None: as many as there are CPUs for.
    """
    done = compare_runs(
        runs,
        out=out,
        evaluation=evaluation,
        scratch=scratch,
        oracle=oracle,
        family=family,
        workers=workers,
        say=print,
    )
    print_tables(done.tables)
    _check(done)


_ACTIONS = {
    "run": command(_run, name="study run"),
    "status": command(_status, name="study status"),
}


def study(arguments: list[str]) -> None:
    """Run `maesn study run` or `maesn study status`."""
    action, *rest = arguments or [""]
    if action in ("-h", "--help"):
        print(
            "usage: maesn study {run,status} FILE [OPTIONS]\n\n"
            "FILE is a .toml file that says what is trained, evaluated and compared, or the name\n"
            f"of a study that comes with the library: {', '.join(shipped_studies())}."
        )
        return
    if action not in _ACTIONS:
        raise RunError("say `maesn study run FILE` or `maesn study status FILE`.")
    _ACTIONS[action](rest)


def _list(execution: Execution, workers: int) -> None:
    """Print the jobs and what they take."""
    jobs = execution.jobs.values()
    rows = tuple((job.name, f"{job.steps:,}") for job in jobs)
    table = TextTable(
        f"{len(rows)} jobs",
        ("job", "environment steps"),
        (*rows, ("all", f"{sum(job.steps for job in jobs):,}")),
        (execution.left(workers),),
    )
    print_tables([table])


def _check(done: Results) -> None:
    """Let the command fail if a job did."""
    if done.failed:
        name, error = next(iter(done.failed.items()))
        raise RunError(
            f"{len(done.failed)} jobs failed, the first is `{name}`: {error} All that do not "
            "need them are done; the same command tries them again."
        )
