"""All methods' adaptation curves over the same tasks, against environment steps."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from maesn.report.comparison import Comparison
from maesn.report.figures.curves import draw_line, explain, note_on_lines, percent_axis
from maesn.report.style import DARK_GREY, ONE_COLUMN, new_figure, publication_style

_HEIGHT = 3.4  # inches, without the legend
_HEIGHTS = (1.5, 1.0)  # return above, success below
_LINE_CHARACTERS = 58  # of a note in one column


@publication_style()
def plot_comparison(comparison: Comparison) -> Figure:
    """Draw return and success over the steps that were learned from in the new task.

    Baseline and oracle are horizontal lines. The curve of a policy with recurrent state is faint
    beyond the length of the trials that it was trained on. The legend says where a method was
    adapted to the first tasks alone.
    """
    lines = comparison.lines
    most_tasks = max(line.num_tasks for line in lines)
    figure = new_figure(ONE_COLUMN, _HEIGHT)
    panels = figure.subplots(2, 1, sharex=True, height_ratios=_HEIGHTS)
    for axes, measure in zip(panels, ("mean_return", "success_rate"), strict=True):
        labels = {}
        for line in lines:
            fewer = "" if line.num_tasks == most_tasks else f" ({_first_tasks(line.num_tasks)})"
            labels[line.label] = draw_line(axes, comparison.steps(line), line, measure, fewer)
    _draw_bounds(panels[0], *comparison.bounds(most_tasks))
    panels[0].set_ylabel(f"mean {lines[0].tables[0].reward} return")
    percent_axis(panels[1], "success rate")
    _steps_axis(panels[1], comparison)
    explain(figure, panels[0], note_on_lines(lines, labels), _LINE_CHARACTERS)
    return figure


def _first_tasks(number: int) -> str:
    return "first task" if number == 1 else f"first {number} tasks"


def _draw_bounds(axes: Axes, baseline: float, oracle: float | None) -> None:
    for height, name in ((baseline, "baseline"), (oracle, "oracle")):
        if height is not None:
            style = "-" if name == "oracle" else (0, (1.0, 1.5))
            axes.axhline(height, color=DARK_GREY, linewidth=0.8, linestyle=style, label=name)


def _steps_axis(axes: Axes, comparison: Comparison) -> None:
    """Count steps; beyond the shortest update logarithmically, if the updates differ in length."""
    counts = [comparison.steps(line) for line in comparison.lines]
    shortest = {int(steps[1]) for steps in counts if len(steps) > 1}
    axes.set_xlabel("environment steps in the new task")
    if len(shortest) > 1:
        axes.set_xscale("symlog", linthresh=min(shortest), linscale=0.5)
        axes.set_xlim(left=0)
    else:
        axes.ticklabel_format(axis="x", style="sci", scilimits=(-3, 4))
