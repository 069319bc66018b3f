"""Where methods end: a dot for each with its interval, and performance profiles."""

import numpy as np
from matplotlib.axes import Axes

from maesn.reporting.adaptation_table import Line
from maesn.reporting.comparison import Comparison
from maesn.reporting.figures.curves import draw_curve, note_on_lines, percent_axis
from maesn.reporting.statistics import bootstrap, mean, performance_profile
from maesn.reporting.style import (
    DARK_GREY,
    TWO_COLUMNS,
    Drawn,
    new_figure,
    publication_style,
)

_ROW = 0.22  # inches
_THRESHOLDS = 101
_NOTE = "dots: means after the last update; bars: 95 % intervals; small dots: seeds"


@publication_style()
def plot_ends(comparison: Comparison, title: str) -> Drawn:
    """Draw each line's last mean return and success as a dot with its 95 % interval."""
    lines = comparison.lines
    figure = new_figure(TWO_COLUMNS, 0.9 + _ROW * len(lines))
    panels = figure.subplots(1, 2, sharey=True)
    for axes, measure, title in zip(
        panels,
        ("mean_return", "success_rate"),
        (f"mean {lines[0].table.reward} return", "reaches goal (%)"),
        strict=True,
    ):
        for row, line in enumerate(reversed(lines)):
            _draw_end(axes, row, line, measure)
        axes.set_xlabel(title)
        axes.grid(axis="x", linewidth=0.3)
    baseline, oracle = comparison.bounds(max(line.num_tasks for line in lines))
    for value, style in ((baseline, ":"), (oracle, "-")):
        if value is not None:
            panels[0].axvline(value, color=DARK_GREY, linewidth=0.8, linestyle=style)
    panels[0].set_yticks(range(len(lines)), [line.label for line in reversed(lines)])
    panels[0].set_ylim(-0.6, len(lines) - 0.4)
    figure.suptitle(title)
    return Drawn(figure, [_NOTE])


def _draw_end(axes: Axes, row: int, line: Line, measure: str) -> None:
    """Draw one dot, its interval, and a small dot for each seed."""
    last = line.measure(measure)[..., -1] * (100 if measure == "success_rate" else 1)
    interval = bootstrap(mean, last)
    if interval.is_known:
        axes.plot([interval.low, interval.high], [row, row], color=line.style.colour, marker="")
    if len(last) > 1:
        seeds = last.mean(axis=1)
        axes.plot(seeds, np.full(len(seeds), row), ".", color=line.style.colour, markersize=2.5)
    axes.plot(interval.mean, row, line.style.marker, color=line.style.colour)


@publication_style()
def plot_profiles(comparison: Comparison, title: str) -> Drawn:
    """Draw, for each return, in which share of tasks and seeds a line ends above it."""
    lines = comparison.lines
    ends = [line.measure("mean_return")[..., -1] for line in lines]
    low, high = min(map(np.min, ends)), max(map(np.max, ends))
    thresholds = np.linspace(low, high, _THRESHOLDS)
    figure, labels = new_figure(TWO_COLUMNS, 2.2), {}
    axes = figure.subplots()
    for line, last in zip(lines, ends, strict=True):
        intervals = performance_profile(last, thresholds)
        curve = np.array([(one.mean, one.low, one.high) for one in intervals]).T
        draw_curve(axes, thresholds, curve, line.style, len(line.seeds))
        labels[line.label] = intervals[0].label
    axes.set_xlabel(f"{lines[0].table.reward} return τ")
    percent_axis(axes, "tasks that end above τ")
    figure.suptitle(title)
    figure.legend(loc="outside right upper")
    return Drawn(figure, note_on_lines(lines, labels))
