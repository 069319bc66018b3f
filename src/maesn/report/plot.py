"""Figures of finished runs. Reads files alone: no learner, no simulator, no JAX.

What a figure shows is in `maesn.report.figures`; here is what it is drawn from and where it goes.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TypeAlias

from matplotlib.figure import Figure
from rich.console import Console

from maesn.report.figures import exploration
from maesn.report.figures.adaptation import comparable_curve, plot_adaptation_curves
from maesn.report.figures.curves import plot_learning_curves
from maesn.report.runs import (
    LearningCurve,
    RecordedRun,
    read_exploration,
    read_learning_curve,
    read_run,
)
from maesn.report.series import Series, group_series, group_worlds
from maesn.report.style import MethodStyle, save_figure

_RECORDING = "`maesn plot DIR` records them, if the family says where agent and goal are in a plane"

_RECORDED_TASKS = "test"  # the tasks whose goals an exploration records

Say: TypeAlias = Callable[[str], None]
Figures: TypeAlias = Iterator[tuple[str, Figure]]
"""File names without suffix, and what they show."""


def plot_run_directories(
    directories: Sequence[Path], out: Path, console: Console | None = None
) -> list[Path]:
    """Draw every figure that the runs have data for, each as a PNG and a PDF.

    Runs that differ in their seed alone become one line. Runs in different worlds (family, variant,
    sparse radius or engine) get a directory of figures each, because their returns cannot be
    compared. Sentences say what is missing, with the command that makes it, and which share of the
    goals each method reaches before it adapts. A `RunError` says which file is missing or broken.

    Args:
        directories: at least one run, as `maesn train` and `maesn adapt` leave them.
        out: where the figures go; made if need be.
        console: where the sentences go; None for standard output.
    """
    console = console or Console()
    say = partial(console.print, markup=False, highlight=False, soft_wrap=True)
    distinct: dict[Path, Path] = {}
    for path in directories:
        distinct.setdefault(path.resolve(), path)
    worlds = group_worlds([read_run(path) for path in distinct.values()])
    written: list[Path] = []
    for world, runs in worlds.items():
        directory, series = out / world if len(worlds) > 1 else out, group_series(runs)
        for figures_of in (_learning, _adaptation, _exploration, _latents):
            for name, figure in figures_of(series, say):
                written += save_figure(figure, directory, name)
    return written


def _learning(series: Sequence[Series], say: Say) -> Figures:
    """Draw one figure per training reward; returns of two rewards have no common axis."""
    trained: dict[str, dict[MethodStyle, list[LearningCurve]]] = {}
    missing = []
    for style, run in ((one.style, run) for one in series for run in one.runs):
        curve = read_learning_curve(run.path)
        if curve is None:
            missing.append(run)
            continue
        reward = str(run.settings.get("reward", "dense"))
        trained.setdefault(reward, {}).setdefault(style, []).append(curve)
    _say_missing(missing, "metrics", "`maesn train` or `maesn resume DIR` writes them", say)
    for reward, lines in trained.items():
        yield f"learning-curves-{reward}", plot_learning_curves(lines, reward)


def _adaptation(series: Sequence[Series], say: Say) -> Figures:
    """Draw one figure per task set and reward that some run was adapted to."""
    runs = [run for one in series for run in one.runs]
    sets = list(dict.fromkeys(pair for run in runs for pair in _adapted_sets(run)))
    if not sets:
        _say_missing(runs, "adaptation", "`maesn adapt DIR` writes it", say)
    changed = [file for run in runs for name, file in run.tables().items() if name.changed]
    if changed:
        say(
            "Not drawn, because the rule or the radius was changed in the new tasks or the engine "
            f"asked for by name: {', '.join(f'`{file}`' for file in changed)}."
        )
    for tasks, reward in sets:
        lacking = [run for run in runs if (tasks, reward) not in _adapted_sets(run)]
        command = f"`maesn adapt DIR --tasks {tasks} --reward {reward}` writes it"
        _say_missing(lacking, f"adaptation to the {tasks} tasks with {reward} reward", command, say)
        adapted = [(one, line) for one in series if (line := one.adapted(tasks, reward))]
        published = {line.name: comparable_curve(one.runs[0], line.table) for one, line in adapted}
        figure = plot_adaptation_curves([line for _, line in adapted], published)
        yield f"adaptation-curves-{tasks}-{reward}", figure


def _adapted_sets(run: RecordedRun) -> list[tuple[str, str]]:
    """Return task sets and rewards of a run's adaptations in which nothing was changed."""
    return [(name.tasks, name.reward) for name in run.tables() if not name.changed]


def _exploration(series: Sequence[Series], say: Say) -> Figures:
    """Draw the tasks, what the prior explores, and what its latents contribute."""
    panels: dict[str, exploration.ExplorationPanel] = {}
    for one in series:
        found = ((run, read_exploration(run.path)) for run in one.runs)
        run, recorded = next((pair for pair in found if pair[1]), (one.runs[0], None))
        if recorded is None:
            continue
        table = run.adaptation(_RECORDED_TASKS, "sparse")
        has_goals = table is not None and table.num_tasks == len(recorded.goals)
        reach = table.prior_reach if table is not None and has_goals else None
        if reach is not None:
            say(
                f"{one.label}: {reach.share:.0%} of the {reach.num_tasks} goals "
                f"({_RECORDED_TASKS} tasks) are reached within {reach.episodes} prior episodes."
            )
        panels[one.name] = exploration.ExplorationPanel(one.style, recorded, reach)
    missing = [one.runs[0] for one in series if one.name not in panels]
    _say_missing(missing, "exploration trajectories", _RECORDING, say)
    if panels:
        first, *_ = panels.values()
        yield "task-distribution", exploration.plot_task_distribution(first.exploration)
        yield "exploration", exploration.plot_exploration(list(panels.values()))
    for name, panel in panels.items():
        if panel.exploration.fixed_paths is not None:
            figure = exploration.plot_structured_noise(panel.exploration)
            yield f"structured-noise-{name}", figure


def _latents(series: Sequence[Series], _: Say) -> Figures:
    """Draw the latents of each method that has them, for each task set that it was adapted to."""
    for one in series:
        run = one.runs[0]
        recorded = read_exploration(run.path)
        for tasks, reward in _adapted_sets(run):
            latents = run.latents(tasks, reward)
            if latents is None or latents.mean.shape[-1] < 2:
                continue
            goals = None
            if recorded is not None and tasks == _RECORDED_TASKS:
                goals = recorded.goals if len(recorded.goals) == len(latents.mean) else None
            yield f"latents-{one.name}-{tasks}-{reward}", exploration.plot_latents(latents, goals)


def _say_missing(runs: Sequence[RecordedRun], what: str, command: str, say: Say) -> None:
    paths = ", ".join(f"`{run.path}`" for run in runs)
    if paths:
        say(f"No {what} in {paths}: {command}.")
