"""Commands that work on runs and studies."""

from collections.abc import Callable
from functools import partial, wraps
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg

from maesn import api
from maesn.commands.options import command
from maesn.evaluation import film
from maesn.evaluation.running import Adapted
from maesn.reporting.report import Reported
from maesn.reporting.tables import TextTable, adaptation_tables, print_tables
from maesn.runs.run import Run
from maesn.runtime.storage import read_snapshot
from maesn.runtime.table import facts
from maesn.studies import comparison
from maesn.studies.study import FailedJobsError, Results, Study


def say_what_is_next(run: Run) -> None:
    """Print where a trained run is, and the command that adapts it."""
    print(f"trained: {run.directory}\nnext:    maesn adapt {run.typed}")


def _say_adapted(done: Adapted) -> None:
    print_tables(adaptation_tables(done.table))
    print(f"table:   {done.table}")
    if done.latents is not None:
        print(f"latents: {done.latents}")


def _say_reported(done: Reported) -> None:
    print_tables(done.tables)
    _say_written(done.files)


def _say_written(paths: list[Path]) -> None:
    print(*paths, sep="\n")


def _say_exported(path: Path) -> None:
    print("In the simulation. Compare it with the robot:")
    for what, value in facts(read_snapshot(path).exported):
        print(f"  {what:20s} {value}")
    print(path)


resume = command(api.resume, say_what_is_next)
adapt = command(api.adapt, _say_adapted)
report = command(api.report, _say_reported)
export = command(api.export, _say_exported)
prior = command(api.prior, print)
render = command(film.render, _say_written)


@command
def study(
    action: Positional[Literal["run", "status"]],
    file: Positional[Annotated[str, arg(metavar="STUDY")]],
    *,
    out: Path = Path("studies"),
    workers: int | None = None,
    only: Annotated[str | None, arg(metavar="JOB")] = None,
) -> None:
    """Compute a study: train, adapt, compare. What was interrupted goes on with the same command.

    Args:
        action: run: compute it. status: show its jobs, their environment steps and how they are,
            and an estimate of the time left; compute nothing.
        file: A .toml file, or the name of a study that comes with the library.
        out: Directory of jobs and results; studies there share jobs.
        workers: Jobs at a time; None: as many as there are CPUs for.
        only: The one job to compute, as a job of an array does.
    """
    asked = Study.load(file)
    if action == "run":
        _say_results(partial(asked.run, out, workers=workers, only=only, say=print))
        return
    execution = asked.execution(out)
    jobs, left = execution.jobs, execution.left(asked.workers(workers))
    rows = [(name, f"{job.steps:,}", *execution.status(job)) for name, job in jobs.items()]
    rows.append(("all", f"{sum(job.steps for job in jobs.values()):,}", "", ""))
    columns = ("job", "environment steps", "status", "")
    print_tables([TextTable(f"{len(jobs)} jobs", columns, tuple(rows), (left,))])


@command
@wraps(comparison.compare)
def compare(*runs: Any, **options: Any) -> None:
    """Compare runs that exist, and say how far it is."""
    _say_results(partial(comparison.compare, *runs, **options | {"say": print}))


def _say_results(compute: Callable[[], Results]) -> None:
    """Print the tables that a study leaves, also where some of its jobs fail."""
    try:
        tables = compute().tables
    except FailedJobsError as error:
        print_tables(error.results.tables)
        raise
    print_tables(tables)
