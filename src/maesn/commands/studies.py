"""Commands that compare: studies, and runs that exist."""

from functools import wraps
from pathlib import Path
from typing import Any

from tyro.conf import Positional

from maesn.commands.options import command
from maesn.evaluation.arguments import Flag
from maesn.reporting.tables import TextTable, print_tables
from maesn.storage import RunError
from maesn.studies.execution import ExecutorName
from maesn.studies.reading import shipped_studies
from maesn.studies.study import Results, Study
from maesn.studies.study import compare as compare_runs


def _run(
    file: Positional[str],
    *,
    out: Path = Path("studies"),
    executor: ExecutorName = "local",
    workers: int | None = None,
    only: str | None = None,
    dry_run: Flag = False,
) -> None:
    """Compute a study: train, adapt, compare. What was interrupted goes on with the same command.

    Args:
        file: A .toml file, or the name of a study that comes with the library.
        out: Directory of jobs and results; studies there share jobs.
        executor: local: processes of this machine. ray: the cluster of RAY_ADDRESS, else one here.
        workers: Jobs at a time; None: as many as there are CPUs for.
        only: The one job to compute, as a job of an array does.
        dry_run: List the jobs with their steps and an estimate of the time; compute nothing.
    """
    study = Study.load(file)
    if not dry_run:
        where = {"executor": executor, "workers": workers, "only": only}
        _show(study.run(out, **where, say=print))  # type: ignore[arg-type]
        return
    jobs = study.jobs.values()
    rows = [(job.name, f"{job.steps:,}") for job in jobs]
    rows.append(("all", f"{sum(job.steps for job in jobs):,}"))
    left = study.execution(out).left(workers or 1)
    columns = ("job", "environment steps")
    print_tables([TextTable(f"{len(jobs)} jobs", columns, tuple(rows), (left,))])


def _status(file: Positional[str], *, out: Path = Path("studies"), workers: int = 1) -> None:
    """Show how the jobs of a study are: done, running, waiting or failed, and the time left.

    Args:
        file: As for `maesn study run`.
        out: Its directory.
        workers: Jobs at a time, for the estimate.
    """
    execution = Study.load(file).execution(out)
    rows = tuple((name, *execution.status(job)) for name, job in execution.jobs.items())
    print_tables([TextTable("Jobs", ("job", "status", ""), rows, (execution.left(workers),))])


@command
@wraps(compare_runs)
def compare(*runs: Any, **options: Any) -> None:
    """Compare runs that exist, and say how far it is."""
    _show(compare_runs(*runs, **options | {"say": print}))


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


def _show(done: Results) -> None:
    """Print the tables; let the command fail if a job did."""
    print_tables(done.tables)
    if done.failed:
        name, error = next(iter(done.failed.items()))
        raise RunError(
            f"{len(done.failed)} jobs failed, the first is `{name}`: {error} All that do not "
            "need them are done; the same command tries them again."
        )
