"""What learning curves and adaptation curves have in common."""

import math
import textwrap
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Real
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from maesn.report.adaptation_table import Line, note_on_judging
from maesn.report.statistics import mean_intervals
from maesn.report.style import MethodStyle

_NUM_MARKERS = 6
_BAND_OPACITY = 0.18
_FAINT = 0.35  # opacity of what a method was never trained for
_LEGEND_COLUMNS = 4
_LEGEND_LINE = 0.145  # inches
_LINE_CHARACTERS = 110  # of a note across two columns
_HANDLE_CHARACTERS = 10  # as wide as a legend's sample line and the gap beside it

Curve = Float[np.ndarray, "mean_low_high point"]
"""A line and the ends of its band."""


def draw_curve(
    axes: Axes, x: Real[np.ndarray, " point"], curve: Curve, style: MethodStyle, num_seeds: int
) -> None:
    """Draw a line and its band in its method's style; the label says if it has several seeds."""
    mean, *ends = curve
    axes.fill_between(x, *ends, color=style.colour, alpha=_BAND_OPACITY, linewidth=0)
    axes.plot(
        x,
        mean,
        color=style.colour,
        linestyle=style.line,
        marker=style.marker,
        markevery=max(1, len(x) // _NUM_MARKERS),
        markeredgecolor="white",
        markeredgewidth=0.4,
        label=style.label if num_seeds == 1 else f"{style.label}, {num_seeds} seeds",
    )
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=6, steps=[1, 2, 5, 10]))


def draw_line(
    axes: Axes, x: Real[np.ndarray, " point"], line: Line, measure: str, addition: str = ""
) -> str:
    """Draw the mean of a measure with its intervals, and return what the intervals resample.

    What meta-training has not prepared a method for is faint.

    Each column of the line's tables stands at its `x`. The legend puts `addition` behind the label.
    """
    intervals = mean_intervals(line.measure(measure))
    curve = np.array([(one.mean, one.low, one.high) for one in intervals]).T
    style = replace(line.style, label=line.label + addition)
    beyond = line.table.first_beyond
    end = len(x) if beyond is None else max(beyond, 1)
    draw_curve(axes, x[:end], curve[:, :end], style, len(line.seeds))
    if end < len(x):
        x, (mean, *ends) = x[end - 1 :], curve[:, end - 1 :]
        axes.plot(x, mean, color=style.colour, linestyle=":", alpha=_FAINT)
        axes.fill_between(x, *ends, color=style.colour, alpha=_FAINT / 4, linewidth=0)
    return intervals[0].label


def percent_axis(axes: Axes, label: str) -> None:
    """Let the vertical axis run from 0 to 100 %."""
    axes.set(ylabel=label, ylim=(-0.03, 1.03))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))


def note_on_lines(lines: Sequence[Line], labels: Mapping[str, str]) -> list[str]:
    """Say what the bands are, which episodes are judged, and what is faint.

    `labels` says by the line's label what its band resamples.
    """
    members: defaultdict[str, list[str]] = defaultdict(list)
    for name, label in labels.items():
        members[label].append(name)
    *exceptions, rule = sorted(members, key=lambda label: len(members[label]))
    bands = [f"bands of {', '.join(members[label])}: {label}" for label in exceptions]
    bands.append(f"{'other bands' if bands else 'bands'}: {rule}")
    faint = [
        f"{line.label}, faint: beyond the {line.table.trial_episodes} episodes that it was trained "
        "for"
        for line in lines
        if line.table.first_beyond is not None
    ]
    return [*bands, note_on_judging(lines), *faint]


def explain(
    figure: Figure, axes: Axes, notes: Sequence[str], line_characters: int = _LINE_CHARACTERS
) -> None:
    """Put notes and the legend of one panel below all panels; the figure grows by their height."""
    handles, labels = axes.get_legend_handles_labels()
    fitting = line_characters // (max(map(len, labels)) + _HANDLE_CHARACTERS)
    columns = max(1, min(len(labels), _LEGEND_COLUMNS, fitting))
    note = "\n".join(textwrap.fill(line, line_characters) for line in notes)
    legend = figure.legend(handles, labels, loc="outside lower center", ncols=columns, title=note)
    legend.get_title().set_multialignment("center")
    lines = math.ceil(len(labels) / columns) + note.count("\n") + 1
    figure.set_figheight(figure.get_figheight() + _LEGEND_LINE * lines)
