"""Figures of finished runs. Reads files alone: no learner, no simulator, no JAX.

What a figure shows is in `maesn.report.figures`; here is what it is drawn from and where it goes.
"""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeAlias

from rich.console import Console

from maesn.report.adaptation_table import AdaptationTable
from maesn.report.figures.adaptation import AdaptedSeries, plot_adaptation_curves
from maesn.report.figures.exploration import ExploringSeries, plot_exploration
from maesn.report.figures.latents import plot_latents
from maesn.report.figures.learning import TrainedSeries, plot_learning_curves
from maesn.report.figures.structured_noise import plot_structured_noise
from maesn.report.figures.task_distribution import plot_task_distribution
from maesn.report.published import is_comparable, published_curve
from maesn.report.runs import (
    RecordedRun,
    read_exploration,
    read_latents,
    read_learning_curve,
    read_run,
)
from maesn.report.series import Series, group_series, group_worlds
from maesn.report.style import save_figure
from maesn.report.table_name import table_name
from maesn.storage import RunError

_RECORDING = "`maesn plot DIR` records them, if the family says where agent and goal are in a plane"

Say: TypeAlias = Callable[[str], None]

# Of a run adapted to several task sets, the first of these says how many goals are reached.
_PREFERRED_SETS = ("test", "validation", "training", "ood")


def plot_run_directories(
    directories: Sequence[Path], out: Path, console: Console | None = None
) -> list[Path]:
    """Draw every figure that the runs have data for.

    Runs that differ in their seed alone become one line. Runs in different worlds (family, variant
    or sparse radius) get a directory of figures each, because their returns cannot be compared.
    What is missing is said in a sentence each, with the command that makes it; so is the share of
    goals that each method reaches before it adapts.

    Args:
        directories: of runs, as `maesn train` and `maesn adapt` leave them.
        out: where the figures go; made if need be.
        console: where the sentences go; None for standard output.

    Returns:
        The files written, a PNG and a PDF for each figure.

    Raises:
        RunError: if a directory holds no run, or a file in it is broken.
    """
    if not directories:
        raise RunError("Expected at least one run directory in `directories`, got none.")
    console = Console() if console is None else console

    def say(sentence: str) -> None:
        console.print(sentence, markup=False, highlight=False, soft_wrap=True)

    worlds = group_worlds([read_run(path) for path in _distinct(directories)])
    written: list[Path] = []
    for name, runs in worlds.items():
        written += _plot_world(runs, out / name if len(worlds) > 1 else out, say)
    return written


def _distinct(directories: Sequence[Path]) -> list[Path]:
    first: dict[Path, Path] = {}
    for path in directories:
        first.setdefault(path.resolve(), path)
    return list(first.values())


def _plot_world(runs: Sequence[RecordedRun], out: Path, say: Say) -> list[Path]:
    series = group_series(runs)
    return [
        *_plot_learning(series, out, say),
        *_plot_adaptation(series, out, say),
        *_plot_exploration(series, out, say),
        *_plot_latents(series, out),
    ]


def _plot_learning(series: Sequence[Series], out: Path, say: Say) -> list[Path]:
    """Draw one figure per training reward; returns of two rewards have no common axis."""
    trained: dict[str, list[TrainedSeries]] = {}
    missing: list[RecordedRun] = []
    for line in series:
        curves = {run: read_learning_curve(run.path) for run in line.runs}
        missing += [run for run, curve in curves.items() if curve is None]
        finished = tuple(curve for curve in curves.values() if curve is not None)
        if finished:
            reward = str(line.runs[0].settings.get("reward", "dense"))
            trained.setdefault(reward, []).append(TrainedSeries(line, finished))
    _say_missing(missing, "metrics", "`maesn train` or `maesn resume DIR` writes them", say)
    return [
        file
        for reward, lines in trained.items()
        for file in save_figure(
            plot_learning_curves(lines, reward), out, f"learning-curves-{reward}"
        )
    ]


def _plot_adaptation(series: Sequence[Series], out: Path, say: Say) -> list[Path]:
    """Draw one figure per task set and reward that some run was adapted to."""
    runs = [run for line in series for run in line.runs]
    sets = list(dict.fromkeys(pair for run in runs for pair in _adapted_sets(run)))
    if not sets:
        _say_missing(runs, "adaptation", "`maesn adapt DIR` writes it", say)
    _say_changed(runs, say)
    written: list[Path] = []
    for tasks, reward in sets:
        lacking = [run for run in runs if (tasks, reward) not in _adapted_sets(run)]
        command = f"`maesn adapt DIR --tasks {tasks} --reward {reward}` writes it"
        _say_missing(lacking, f"adaptation to the {tasks} tasks with {reward} reward", command, say)
        adapted = [line for line in (_adapted(one, tasks, reward) for one in series) if line]
        figure = plot_adaptation_curves(adapted)
        written += save_figure(figure, out, f"adaptation-curves-{tasks}-{reward}")
    return written


def _adapted_sets(run: RecordedRun) -> list[tuple[str, str]]:
    """Return task sets and rewards of a run's adaptations in which nothing was changed."""
    names = [table_name(file) for file in run.adaptation_files()]
    return [(name.tasks, name.reward) for name in names if not name.changed]


def _adapted(series: Series, tasks: str, reward: str) -> AdaptedSeries | None:
    found = [(run, run.adaptation(tasks, reward)) for run in series.runs]
    tables = tuple(table for _, table in found if table is not None)
    if not tables:
        return None
    first = series.runs[0]
    comparable = is_comparable(first.settings, tables[0])
    published = published_curve(first.family, first.method) if comparable else None
    return AdaptedSeries(series, tables, published)


def _plot_exploration(series: Sequence[Series], out: Path, say: Say) -> list[Path]:
    """Draw the tasks, what the prior explores, and what its latents contribute."""
    exploring = [panel for panel in map(_exploring, series) if panel is not None]
    drawn = {panel.series.name for panel in exploring}
    missing = [line.runs[0] for line in series if line.name not in drawn]
    _say_missing(missing, "exploration trajectories", _RECORDING, say)
    if not exploring:
        return []
    for panel in exploring:
        _say_share(panel, say)
    written = save_figure(
        plot_task_distribution(exploring[0].exploration), out, "task-distribution"
    )
    written += save_figure(plot_exploration(exploring), out, "exploration")
    for panel in exploring:
        if panel.exploration.fixed_paths is not None:
            figure = plot_structured_noise(panel.exploration)
            written += save_figure(figure, out, f"structured-noise-{panel.series.name}")
    return written


def _exploring(series: Series) -> ExploringSeries | None:
    """Return what the first of a series' runs that has trajectories explores."""
    for run in series.runs:
        exploration = read_exploration(run.path)
        if exploration is not None:
            return ExploringSeries(series, exploration, _sparse_table(run, len(exploration.goals)))
    return None


def _sparse_table(run: RecordedRun, num_goals: int) -> AdaptationTable | None:
    """Return a run's adaptation with sparse reward to that many tasks, the test set first."""
    sets = [tasks for tasks, reward in _adapted_sets(run) if reward == "sparse"]
    sets.sort(key=lambda tasks: (*_PREFERRED_SETS, tasks).index(tasks))
    tables = (run.adaptation(tasks, "sparse") for tasks in sets)
    return next((table for table in tables if table and table.num_tasks == num_goals), None)


def _say_share(panel: ExploringSeries, say: Say) -> None:
    table = panel.table
    reach = None if table is None else table.prior_reach
    if table is not None and reach is not None:
        say(
            f"{panel.series.label}: {reach.share:.0%} of the {reach.num_tasks} goals "
            f"({table.tasks} tasks) are reached within {reach.episodes} prior episodes."
        )


def _plot_latents(series: Sequence[Series], out: Path) -> list[Path]:
    """Draw the latents of each method that has them, for each task set that it was adapted to."""
    written: list[Path] = []
    for line in series:
        run = line.runs[0]
        exploration = read_exploration(run.path)
        for tasks, reward in _adapted_sets(run):
            latents = read_latents(run.path, tasks, reward)
            if latents is None or latents.num_components < 2:
                continue
            goals = None if exploration is None else exploration.goals
            if goals is not None and len(goals) != latents.num_tasks:
                goals = None
            name = f"latents-{line.name}-{tasks}-{reward}"
            written += save_figure(plot_latents(latents, goals), out, name)
    return written


def _say_changed(runs: Iterable[RecordedRun], say: Say) -> None:
    files = [file for run in runs for file in run.adaptation_files() if table_name(file).changed]
    if files:
        places = ", ".join(f"`{file}`" for file in files)
        say(
            "Not drawn, because the learner was changed in the new tasks or the engine asked for "
            f"by name: {places}."
        )


def _say_missing(runs: Iterable[RecordedRun], what: str, command: str, say: Say) -> None:
    places = ", ".join(f"`{run.path}`" for run in runs)
    if places:
        say(f"No {what} in {places}: {command}.")
