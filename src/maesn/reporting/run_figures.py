"""Figures of finished runs. Reads files alone: no learner, no simulator, no JAX.

What a figure shows is in `maesn.reporting.figures`; here is what it is drawn from.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeAlias

from maesn.reporting.figures import exploration
from maesn.reporting.figures.curves import plot_curves, plot_learning_curves
from maesn.reporting.runs import (
    EXPLORATION,
    RECORDED_TASKS,
    LearningCurve,
    RecordedExploration,
    RecordedRun,
    read_learning_curve,
    read_recorded,
)
from maesn.reporting.series import Series, compare_runs, group_series, read_runs
from maesn.reporting.style import Drawn, MethodStyle, save_figure

_RECORDING = "`maesn report DIR` records them, if the family says where things are in a plane"

Say: TypeAlias = Callable[[str], None]
Figures: TypeAlias = Iterator[tuple[str, Drawn]]
"""File names without suffix, and what they show."""


def draw_runs(directories: Sequence[Path], out: Path, say: Say) -> list[Path]:
    """Draw every figure that the runs have data for, each as a PNG and a PDF, and return these.

    Runs that differ in their seed alone become one line. `say` receives sentences of what is
    missing, with the command that makes it, and of the goals that each method reaches before it
    adapts. A `RunError` says which file is broken, or why the runs cannot be compared.
    """
    written, series = [], group_series(read_runs(directories))
    for figures_of in (_learning, _adaptation, _exploration, _latents):
        for name, drawn in figures_of(series, say):
            written += save_figure(drawn, out, name)
    return written


def _learning(series: Sequence[Series], say: Say) -> Figures:
    """Draw one figure per training reward; returns of two rewards have no common axis."""
    trained: defaultdict[str, dict[MethodStyle, list[LearningCurve]]] = defaultdict(dict)
    missing = []
    for style, run in ((one.style, run) for one in series for run in one.runs):
        curve = read_learning_curve(run.path)
        if curve is None:
            missing.append(run)
        else:
            lines = trained[str(run.settings.get("reward", "dense"))]
            lines.setdefault(style, []).append(curve)
    _say_missing(missing, "metrics", "`maesn train` or `maesn resume DIR` writes them", say)
    for reward, lines in trained.items():
        yield f"learning-curves-{reward}", plot_learning_curves(lines, reward)


def _adaptation(series: Sequence[Series], say: Say) -> Figures:
    """Draw one figure per task set and reward that some run was adapted to, with all rules."""
    comparisons = compare_runs(series)
    if not comparisons:
        runs = [run for one in series for run in one.runs]
        _say_missing(runs, "adaptation", "`maesn adapt DIR` writes it", say)
    for found in comparisons:
        table, sources = found.lines[0].table, {line.source for line in found.lines}
        for one in series:
            if one.name not in sources:
                what = f"adaptation to the {table.tasks} tasks with {table.reward} reward"
                command = f"`maesn adapt DIR --tasks {table.tasks} --reward {table.reward}`"
                _say_missing(one.runs, what, f"{command} writes it", say)
        yield f"adaptation-curves-{found.name}", plot_curves(found)


def _exploration(series: Sequence[Series], say: Say) -> Figures:
    """Draw the tasks, what the prior explores, and what its latents contribute."""
    panels: dict[str, exploration.ExplorationPanel] = {}
    for one in series:
        run, recorded = _explored(one)
        if recorded is None:
            _say_missing(one.runs, "exploration trajectories", _RECORDING, say)
            continue
        table = run.adaptation(RECORDED_TASKS, "sparse")
        has_goals = table is not None and table.num_tasks == len(recorded.goals)
        reach = table.prior_reach if table is not None and has_goals else None
        if reach is not None:
            say(
                f"{one.label}: {reach.share:.0%} of the {reach.num_tasks} goals "
                f"({RECORDED_TASKS} tasks) are reached within {reach.episodes} prior episodes."
            )
        panels[one.name] = exploration.ExplorationPanel(one.style, recorded, reach)
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
        run, recorded = one.runs[0], _explored(one)[1]
        for name in run.tables():
            latents = None if name.changed else run.latents(name.tasks, name.reward)
            if latents is None or latents.mean.shape[-1] < 2:
                continue
            goals = recorded.goals if recorded and name.tasks == RECORDED_TASKS else None
            if goals is not None and len(goals) != len(latents.mean):
                goals = None
            figure = exploration.plot_latents(latents, goals)
            yield f"latents-{one.name}-{name.tasks}-{name.reward}", figure


def _explored(one: Series) -> tuple[RecordedRun, RecordedExploration | None]:
    """Return the first run that has recorded an exploration, and that; None if none has."""
    found = ((run, read_recorded(RecordedExploration, run.path / EXPLORATION)) for run in one.runs)
    return next((pair for pair in found if pair[1] is not None), (one.runs[0], None))


def _say_missing(runs: Sequence[RecordedRun], what: str, command: str, say: Say) -> None:
    if runs:
        say(f"No {what} in {', '.join(f'`{run.path}`' for run in runs)}: {command}.")
