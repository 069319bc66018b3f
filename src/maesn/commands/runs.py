"""Commands that work on runs and studies, and the demo."""

from collections.abc import Callable
from functools import partial, wraps
from itertools import chain
from pathlib import Path
from typing import Any, Literal

from tyro.conf import Positional

from maesn import api
from maesn.commands.options import command
from maesn.evaluation import film
from maesn.evaluation.arguments import Flag
from maesn.evaluation.running import Adapted
from maesn.learners import recommended
from maesn.numerics.processes import is_lead
from maesn.reporting.report import Reported
from maesn.reporting.sources import MANIFEST, joined_files, studies_in
from maesn.reporting.tables import TextTable, adaptation_tables, print_tables
from maesn.rules import SearchRule
from maesn.runs.config import CONFIG, RunSettings
from maesn.runs.export import exported_facts
from maesn.runs.run import Run
from maesn.storage import RunError, read_json, refusals
from maesn.studies import comparison
from maesn.studies.execution import Execution
from maesn.studies.executors import ExecutorName
from maesn.studies.study import JOBS, FailedJobsError, Results, Study


def say_what_is_next(run: Run) -> None:
    """Print where a trained run is, and the command that adapts it."""
    if is_lead():
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
    for what, value in exported_facts(path):
        print(f"  {what:20s} {value}")
    print(path)


resume = command(api.resume, say_what_is_next)
adapt = command(api.adapt, _say_adapted)
report = command(api.report, _say_reported)
export = command(api.export, _say_exported)
prior = command(api.prior, print)
render = command(film.render, _say_written)


@command
def demo(run: Path = Path("runs/demo"), iterations: int = 80, seed: int = 0) -> None:
    """Train MAESN on the wheeled robot, adapt it to unseen sparse tasks, draw the figures.

    Args:
        run: Directory of the run; a demo that was interrupted goes on where it stopped.
        iterations: Meta-iterations. 300 explore better, in three times as long.
        seed: Seed of all random draws of the run.
    """
    print(f"1. MAESN learns to explore: {iterations} meta-iterations on dense reward")
    with refusals():
        settings = RunSettings(iterations=iterations, seed=seed)
    if (run / CONFIG).exists():
        begun = Run.open(run).settings
        if (begun.method, begun.family, begun.seed) != ("maesn", settings.family, seed):
            raise RunError(f"`{run}` holds another run than this demo: give another `--run`.")
        api.resume(run, iterations)
    else:
        api.train(recommended("maesn", settings.family), settings, run)
    print("2. it adapts to 100 unseen goals, which it does not see, on sparse reward")
    gradient = api.adapt(run)
    api.prior(run)
    search = api.adapt(run, rule=SearchRule())
    for done in (gradient, search):
        print_tables(adaptation_tables(done.table))
    print("3. figures")
    _say_reported(api.report([run]))


@command
def study(
    action: Positional[Literal["run", "status"]],
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
        action: run: compute it. status: show how its jobs are, and the time left.
        file: A .toml file, or the name of a study that comes with the library. For status also the
            directory that `--out` named: all studies in it.
        out: Directory of jobs and results; studies there share jobs.
        executor: local: processes of this machine. ray: the cluster of RAY_ADDRESS, else one here.
        workers: Jobs at a time; None: as many as there are CPUs for.
        only: The one job to compute, as a job of an array does.
        dry_run: List the jobs with their steps and an estimate of the time; compute nothing.
    """
    if action == "status" and (found := studies_in(Path(file))):
        print_tables([_jobs_of(directory) for directory in found])
        return
    asked = Study.load(file)
    if action == "run" and not dry_run:
        where = {"executor": executor, "workers": workers, "only": only}
        _say_results(partial(asked.run, out, **where, say=print))  # type: ignore[arg-type]
        return
    execution = asked.execution(out)
    jobs, left = execution.jobs.items(), (execution.left(asked.workers(workers)),)
    if dry_run:
        rows = [(name, f"{job.steps:,}") for name, job in jobs]
        rows.append(("all", f"{sum(job.steps for _, job in jobs):,}"))
        columns = ("job", "environment steps")
        print_tables([TextTable(f"{len(jobs)} jobs", columns, tuple(rows), left)])
    else:
        states = tuple((name, *execution.status(job)) for name, job in jobs)
        print_tables([TextTable("Jobs", ("job", "status", ""), states, left)])


def _jobs_of(study: Path) -> TextTable:
    """Return which jobs of a study are done, from what it has left."""
    names = read_json(study / MANIFEST).get("jobs", [])
    execution = Execution({}, study.parent / JOBS, {*chain(*joined_files(study).values())})
    rows = tuple((name, "done" if execution.is_done(name) else "") for name in names)
    title = f"{study.name}: {sum('done' in row for row in rows)} of {len(rows)} jobs are done"
    return TextTable(title, ("job", ""), rows)


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
