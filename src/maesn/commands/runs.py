"""Commands that work on runs: go on with one, adapt it, draw it, film it, export it; the demo."""

from pathlib import Path

from maesn import api
from maesn.commands.options import command
from maesn.evaluation import film
from maesn.evaluation.running import Adapted
from maesn.learners import recommended
from maesn.numerics.processes import is_lead
from maesn.reporting.tables import print_adaptation_summary, print_tables
from maesn.rules import SearchRule
from maesn.runs.config import CONFIG, RunSettings
from maesn.runs.run import Run
from maesn.storage import RunError, refusals


def say_what_is_next(run: Run) -> None:
    """Print where a trained run is, and the command that adapts it."""
    if is_lead():
        print(f"trained: {run.directory}\nnext:    maesn adapt {run.directory}{run.family_option}")


def _say_adapted(done: Adapted) -> None:
    print_adaptation_summary(done.table)
    print(f"table:   {done.table}")
    if done.latents is not None:
        print(f"latents: {done.latents}")


def _say_reported(done: api.Reported) -> None:
    print_tables(done.tables)
    _say_written(done.files)


def _say_written(paths: list[Path]) -> None:
    print(*paths, sep="\n")


resume = command(api.resume, say_what_is_next)
adapt = command(api.adapt, _say_adapted)
report = command(api.report, _say_reported)
export = command(api.export, print)
prior = command(api.prior, print)
render = command(film.render, _say_written)


@command
def demo(run: Path = Path("runs/demo"), iterations: int = 80, seed: int = 0) -> None:
    """Train MAESN on the wheeled robot, adapt it to unseen sparse tasks, draw the figures.

    Args:
        run: Directory of the run; a demo that was interrupted goes on where it stopped.
        iterations: Meta-iterations. 300 explore better, in three times as long.
        seed: Every random draw of the run follows from this number.
    """
    print(f"1. MAESN learns to explore: {iterations} meta-iterations on dense reward")
    with refusals():
        settings = RunSettings(iterations=iterations, seed=seed)
    if (run / CONFIG).exists():
        begun = Run.open(run).settings
        if (begun.method, begun.family, begun.seed) != ("maesn", settings.family, seed):
            raise RunError(
                f"`{run}` holds a run of {begun.method} on {begun.family} with seed {begun.seed}, "
                f"not of maesn on {settings.family} with seed {seed}: give another `--run`."
            )
        api.resume(run, iterations)
    else:
        api.train(recommended("maesn", settings.family), settings, run)
    print("2. it adapts to 100 unseen goals, which it does not see, on sparse reward")
    gradient = api.adapt(run)
    api.prior(run)
    search = api.adapt(run, rule=SearchRule())
    for done in (gradient, search):
        print_adaptation_summary(done.table)
    print("3. figures")
    _say_reported(api.report([run]))
