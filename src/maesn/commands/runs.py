"""Commands that work on runs: go on with one, adapt it, draw it, film it, export it; the demo."""

from pathlib import Path

import tyro

from maesn import api
from maesn.commands.options import (
    AnyEvaluation,
    EvaluationOptions,
    OwnFamily,
    TrainedRun,
    command,
)
from maesn.evaluation import film
from maesn.learners import recommended
from maesn.report import print_adaptation_summary
from maesn.runs.config import CONFIG, RunSettings
from maesn.runs.run import Run
from maesn.runs.serialization import values_of_words
from maesn.storage import RunError, refusals


@command
def resume(
    run: tyro.conf.Positional[Path],
    iterations: int | None = None,
    family: OwnFamily = None,
    change: tuple[str, ...] = (),
) -> None:
    """Go on with a run from its latest checkpoint, as if it had never stopped.

    Args:
        run: Directory of the run.
        iterations: Total number of meta-iterations; None: what the run was started with.
        change: Settings that are to differ from here on, as NAME=VALUE: `num_threads=2
            reward=sparse trust_region.damping=0.1`. `config.json` keeps a record of it.
    """
    with refusals("`--change`: "):
        changes = values_of_words(change)
    trained = api.resume(run, iterations, family=family, change=changes)
    # Of a run that was begun in Python, the command alone knows where the family is.
    say_what_is_next(trained, f" --family {family}" if family else trained.settings.family_option)


def say_what_is_next(run: Run, family_option: str) -> None:
    """Print where a trained run is, and the command that adapts it."""
    print(f"trained: {run.directory}\nnext:    maesn adapt {run.directory}{family_option}")


@command
def adapt(
    run: TrainedRun,
    out: Path | None = None,
    start: Path | None = None,
    family: OwnFamily = None,
    evaluation: AnyEvaluation = EvaluationOptions(),
) -> None:
    """Adapt the last checkpoint of a run to new tasks, and tabulate how it does.

    Args:
        out: Table to write; None: `DIR/adaptation/TASKS-REWARD.csv`. Latents go beside it.
        start: Latents of an earlier adaptation to the same tasks (`.latents.npz`) to go on from.
    """
    done = api.adapt(run, evaluation.build(), out=out, start=start, family=family)
    print_adaptation_summary(done.table)
    print(f"table:   {done.table}")
    if done.latents is not None:
        print(f"latents: {done.latents}")


@command
def plot(
    runs: tyro.conf.Positional[tuple[Path, ...]],
    out: Path | None = None,
    family: OwnFamily = None,
) -> None:
    """Draw the paper's figures from one or several runs.

    Args:
        runs: Directories of the runs, or names of policies that come with the library (`maesn
            list`); several are compared in one figure. A directory of that name in the current
            folder wins; without one, files go to `maesn-NAME` there, a run directory like any
            other.
        out: Where the figures go; None: `figures` in the first run's directory.
    """
    _print_all(api.plot(runs, out, family=family))


@command
def export(
    run: TrainedRun,
    path: tyro.conf.Positional[Path],
    latents: Path | None = None,
    task: int | None = None,
    family: OwnFamily = None,
) -> None:
    """Write a trained policy as one file for the NumPy runtime.

    Args:
        path: File to write, `.npz`.
        latents: Latents that `maesn adapt` wrote (`.latents.npz`): the robot starts at the adapted
            latent of a task instead of the prior, with the step sizes that `maesn adapt --start`
            would go on with.
        task: Index of that task, in the set that was adapted to.
    """
    _print_all([api.export(run, path, family, latents=latents, task=task)])


@command
def render(
    run: TrainedRun,
    task: int = 0,
    after: tuple[int, ...] = (0, 250),
    shown: int = 4,
    out: Path | None = None,
    family: OwnFamily = None,
    evaluation: AnyEvaluation = EvaluationOptions(),
) -> None:
    """Film how a trained policy explores a new task, and what it does after adapting to it.

    Args:
        task: Index of the task in its set.
        after: Numbers of episodes that the agent has learned from when episodes are shown; 0 is
            before any adaptation, and the last one at most `--episodes`.
        shown: Episodes that are shown each time: the first ones that are played.
        out: Directory of the pictures; None: `DIR/render`.
    """
    asked = evaluation.build()
    _print_all(film.render(run, asked, task=task, after=after, shown=shown, out=out, family=family))


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
        _check_same(Run.open(run), settings)
        api.resume(run, iterations)
    else:
        api.train(recommended("maesn", settings.family), settings, run)
    print("2. it adapts to 100 unseen goals, which it does not see, on sparse reward")
    done = api.adapt(run)
    print_adaptation_summary(done.table)
    reached = (done.curves.success_rate[:, 0] > 0).mean()
    print(f"goals reached by some of 50 episodes before any adaptation: {reached:.0%}")
    print("3. figures")
    _print_all(api.plot([run]))


def _check_same(run: Run, settings: RunSettings) -> None:
    """Refuse to go on with a run that is not this demo's."""
    found = (run.settings.method, run.settings.family, run.settings.seed)
    wanted = ("maesn", settings.family, settings.seed)
    if found != wanted:
        raise RunError(
            f"`{run.directory}` holds a run of {found[0]} on {found[1]} with seed {found[2]}, not "
            f"of {wanted[0]} on {wanted[1]} with seed {wanted[2]}: give another `--run`."
        )


def _print_all(paths: list[Path]) -> None:
    print(*paths, sep="\n")
