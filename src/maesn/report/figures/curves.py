"""Learning curves of meta-training, and what they have in common with adaptation curves."""

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Real
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from maesn.report.adaptation_table import Line, by_text, note_on_judging
from maesn.report.runs import LearningCurve
from maesn.report.statistics import mean_intervals
from maesn.report.style import TWO_COLUMNS, MethodStyle, new_figure, publication_style

# Every iteration draws other tasks, so single ones scatter. A window of 1/30 of the run halves the
# scatter of 100 iterations at the price of 3 % of the horizontal resolution.
_WINDOW_SHARE = 1 / 30
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

    Each column of the line's tables stands at its `x`. What meta-training has not prepared a method
    for is faint. The legend puts `addition` behind the label.
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
    *exceptions, (rule, _) = sorted(by_text(labels).items(), key=lambda pair: len(pair[1]))
    bands = [f"bands of {', '.join(members)}: {text}" for text, members in exceptions]
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


@publication_style()
def plot_learning_curves(
    trained: Mapping[MethodStyle, Sequence[LearningCurve]], reward: str
) -> Figure:
    """Draw return and success over meta-iterations, one line for all seeds of a method.

    A line is the moving average of the mean over seeds; its band is the range of the seeds' own
    moving averages, because three seeds are too few for an interval. A single seed has no band, but
    its raw values behind the line. Seeds are drawn as far as all of a method got.
    """
    figure = new_figure(TWO_COLUMNS, 2.05)
    panels = figure.subplots(1, 3)
    panels[1].sharey(panels[0])
    metrics = ("return_before", "return_after", "success_after")
    windows = set()
    for axes, metric in zip(panels, metrics, strict=True):
        for style, curves in trained.items():
            x = min((curve.iteration for curve in curves), key=len)
            # Odd, so that it has a centre.
            window = 2 * int(len(x) * _WINDOW_SHARE / 2) + 1
            windows.add(window)
            values = np.stack([getattr(curve, metric)[: len(x)] for curve in curves])
            if np.isnan(values).all():
                continue
            if len(values) == 1:
                axes.plot(x, values[0], color=style.colour, linewidth=0.5, alpha=0.3)
            smooth = moving_mean(values, window)
            band = np.stack([smooth.mean(0), smooth.min(0), smooth.max(0)])
            draw_curve(axes, x, band, style, len(values))
        axes.set_title(f"{metric.rpartition('_')[2]} the inner update")
        axes.set_xlabel("meta-iteration")
    panels[0].set_ylabel(f"mean {reward} return")
    percent_axis(panels[2], "success rate")
    widths = " or ".join(map(str, sorted(windows)))
    notes = {
        f"lines: moving average over {widths} iterations": max(windows) > 1,
        "thin: single iterations": any(len(curves) == 1 for curves in trained.values()),
        "bands: range over the seeds": any(len(curves) > 1 for curves in trained.values()),
    }
    explain(figure, panels[1], ["; ".join(note for note, applies in notes.items() if applies)])
    return figure


def moving_mean(
    values: Float[np.ndarray, "seed iteration"], window: int
) -> Float[np.ndarray, "seed iteration"]:
    """Return the centred mean over `window` iterations, over fewer at the ends."""
    ones = np.ones(window)
    counts = np.convolve(np.ones(values.shape[1]), ones, mode="same")
    return np.stack([np.convolve(row, ones, mode="same") for row in values]) / counts
