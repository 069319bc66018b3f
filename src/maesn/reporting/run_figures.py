"""Figures of finished runs. Reads files alone: no learner, no simulator, no JAX.

What a figure shows is in `maesn.reporting.figures`; here is what it is drawn from.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeAlias

from maesn.reporting.adaptation_table import Line
from maesn.reporting.figures import exploration
from maesn.reporting.figures.curves import plot_curves
from maesn.reporting.figures.learning import plot_learning_curves
from maesn.reporting.published import comparable_curve
from maesn.reporting.runs import (
    LearningCurve,
    RecordedRun,
    read_exploration,
    read_learning_curve,
    read_run,
)
from maesn.reporting.series import Series, check_world, group_series
from maesn.reporting.style import Drawn, MethodStyle, save_figure

_RECORDING = "`maesn report DIR` records them, if the family says where things are in a plane"

_RECORDED_TASKS = "test"  # the tasks whose goals an exploration records

Say: TypeAlias = Callable[[str], None]
Figures: TypeAlias = Iterator[tuple[str, Drawn]]
"""File names without suffix, and what they show."""


def draw_runs(directories: Sequence[Path], out: Path, say: Say) -> list[Path]:
    """Draw every figure that the runs have data for, each as a PNG and a PDF.

    Runs that differ in their seed alone become one line. Sentences say what is missing, with the
    command that makes it, and which share of the goals each method reaches before it adapts.

    Args:
        directories: at least one run, as `maesn train` and `maesn adapt` leave them, all on one
            family with one variant, sparse radius and engine.
        out: where the figures go; made if need be.
        say: receives the sentences.

    Raises:
        RunError: a file is missing or broken, or the runs are of different families or the like.
    """
    distinct = {path.resolve(): path for path in reversed(directories)}
    runs = [read_run(path) for path in reversed(distinct.values())]
    check_world(runs)
    written, series = [], group_series(runs)
    for figures_of in (_learning, _adaptation, _exploration, _latents):
        for name, drawn in figures_of(series, say):
            written += save_figure(drawn, out, name)
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
    """Draw one figure per task set and reward that some run was adapted to, with all rules."""
    runs = [run for one in series for run in one.runs]
    sets = dict.fromkeys((name.tasks, name.reward) for run in runs for name in run.tables())
    if not sets:
        _say_missing(runs, "adaptation", "`maesn adapt DIR` writes it", say)
    for tasks, reward in sets:
        lines: list[Line] = []
        published = {}
        for one in series:
            found = one.adapted(tasks, reward)
            run = one.runs[0]
            for line in found:
                world = (run.settings["variant"], run.settings.get("sparse_radius"))
                published[line.name] = comparable_curve(run.family, *world, run.method, line.table)
            if not found:
                command = f"`maesn adapt DIR --tasks {tasks} --reward {reward}` writes it"
                what = f"adaptation to the {tasks} tasks with {reward} reward"
                _say_missing(one.runs, what, command, say)
            lines += found
        title = f"{runs[0].family}, {tasks} tasks, {reward} reward"
        yield f"adaptation-curves-{tasks}-{reward}", plot_curves(lines, title, published=published)


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
    missing = [run for one in series if one.name not in panels for run in one.runs]
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
        for name in run.tables():
            tasks, reward = name.tasks, name.reward
            latents = None if name.changed else run.latents(tasks, reward)
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
