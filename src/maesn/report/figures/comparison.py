"""All methods' adaptation curves over the same tasks, against environment steps."""

from dataclasses import replace

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from maesn.report.comparison import Comparison, Line
from maesn.report.figures.curves import (
    draw_intervals,
    explain,
    note_on_bands,
    note_on_trials,
    percent_axis,
)
from maesn.report.statistics import mean_intervals
from maesn.report.style import DARK_GREY, ONE_COLUMN, new_figure, publication_style

_HEIGHT = 3.4  # inches, without the legend
_HEIGHTS = (1.5, 1.0)  # return above, success below
_LINE_CHARACTERS = 58  # of a note in one column


@publication_style()
def plot_comparison(comparison: Comparison) -> Figure:
    """Draw return and success over the steps that were learned from in the new task.

    Floor and oracle are horizontal lines. What a method with memory does beyond the length of the
    trials that it was trained on is faint. A method that was adapted to the first tasks alone says
    so in the legend.

    Args:
        comparison: what to draw.
    """
    figure = new_figure(ONE_COLUMN, _HEIGHT)
    panels = figure.subplots(2, 1, sharex=True, height_ratios=_HEIGHTS)
    for axes, measure in zip(panels, ("mean_return", "success_rate"), strict=True):
        labels = {
            line.label: _draw_line(axes, comparison, line, measure) for line in comparison.lines
        }
    _draw_bounds(panels[0], comparison)
    panels[0].set_ylabel(f"mean {comparison.lines[0].tables[0].reward} return")
    percent_axis(panels[1], "success rate")
    _steps_axis(panels[1], comparison)
    explain(figure, panels[0], _note(comparison, labels), _LINE_CHARACTERS)
    return figure


def _draw_line(axes: Axes, comparison: Comparison, line: Line, measure: str) -> str:
    """Draw one method and return what its band resamples."""
    intervals, steps = mean_intervals(line.measure(measure)), comparison.steps(line).astype(float)
    style = line.style
    if line.num_tasks < _most_tasks(comparison):
        first = "first task" if line.num_tasks == 1 else f"first {line.num_tasks} tasks"
        style = replace(style, label=f"{line.label} ({first})")
    return draw_intervals(axes, steps, intervals, style, len(line.seeds), line.first_beyond)


def _most_tasks(comparison: Comparison) -> int:
    return max(line.num_tasks for line in comparison.lines)


def _draw_bounds(axes: Axes, comparison: Comparison) -> None:
    floor, oracle = comparison.bounds(_most_tasks(comparison))
    for height, name in ((floor, "floor"), (oracle, "oracle")):
        if height is not None:
            style = "-" if name == "oracle" else (0, (1.0, 1.5))
            axes.axhline(height, color=DARK_GREY, linewidth=0.8, linestyle=style, label=name)


def _steps_axis(axes: Axes, comparison: Comparison) -> None:
    """Count steps; beyond the shortest update logarithmically, if the updates differ in length."""
    shortest = {int(comparison.steps(line)[1]) for line in comparison.lines if _has_updates(line)}
    axes.set_xlabel("environment steps in the new task")
    if len(shortest) > 1:
        axes.set_xscale("symlog", linthresh=min(shortest), linscale=0.5)
        axes.set_xlim(left=0)
    else:
        axes.ticklabel_format(axis="x", style="sci", scilimits=(-3, 4))


def _has_updates(line: Line) -> bool:
    return len(line.tables[0].episodes) > 1


def _note(comparison: Comparison, labels: dict[str, str]) -> str:
    """Say what the bands are, and what is faint."""
    parts = note_on_bands(labels)
    for line in comparison.lines:
        parts += note_on_trials(line.label, line.trial_episodes, line.first_beyond)
    return "\n".join(parts)
