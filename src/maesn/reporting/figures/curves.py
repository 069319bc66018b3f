"""Curves: of meta-training, of methods in new tasks, and of where these end."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.optimize
from jaxtyping import Float, Real
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter, ScalarFormatter

from maesn.reporting import statistics, style
from maesn.reporting.comparison import Comparison, Line, note_on_judging
from maesn.reporting.runs import LearningCurve
from maesn.reporting.style import GREY, Drawn, MethodStyle

_MOST_COLOURS = 5  # more cannot be told apart
_LABEL_SIZE = 6.5  # points
_REFERENCES = {"baseline": "dotted", "oracle": "solid"}  # lines of their mean returns
# Every iteration draws other tasks, so single ones scatter. A window of 1/30 of the run halves the
# scatter of 100 iterations at the price of 3 % of the horizontal resolution.
_WINDOW_SHARE = 1 / 30


@style.publication_style()
def plot_curves(comparison: Comparison) -> Drawn:
    """Draw return and success over the episodes that were learned from in the new task.

    Horizontal lines are the mean returns of baseline and oracle, circles the published curve.
    """
    colours = dict.fromkeys(line.style.colour for line in comparison.lines)
    told = {GREY, *[one for one in colours if one != GREY][:_MOST_COLOURS]}
    lines = tuple(
        line if line.style.colour in told else replace(line, style=replace(line.style, colour=GREY))
        for line in comparison.lines
    )
    figure = style.new_figure(style.TWO_COLUMNS, 2.5)
    returns, success = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    for line in lines:
        for axes, measure in ((returns, "mean_return"), (success, "success_rate")):
            band = statistics.curve(line.measure(measure)).band
            _draw_curve(axes, line.table.episodes, band, line.style, len(line.seeds))
        if line.published is not None:
            episodes = line.published.update * (line.table.episodes_per_update or 1)
            shown = episodes <= line.table.episodes[-1]
            points = (episodes[shown], line.published.mean_return[shown])
            returns.plot(*points, "o", color=line.style.colour, fillstyle="none", markersize=3)
    _episodes_axis(returns, lines)
    _episodes_axis(success, lines)
    for name, value in comparison.references().items():
        returns.axhline(value, label=name, color=style.DARK_GREY, linestyle=_REFERENCES[name])
    returns.set_ylabel(f"mean {lines[0].table.reward} return")
    _percent_axis(success, "success rate")
    returns.set_title(comparison.title, loc="left")
    _label_lines(figure, returns)
    most = max(line.num_tasks for line in lines)
    fewer = [line for line in lines if line.num_tasks < most]
    notes = [
        f"bands: {statistics.INTERVAL}; circles: as published, where the paper shows the method",
        note_on_judging(lines),
        *(line.beyond for line in lines if line.beyond),
        *(f"{line.label}: the first {line.num_tasks} of {most} tasks alone" for line in fewer),
    ]
    return Drawn(figure, notes)


@style.publication_style()
def plot_ends(comparison: Comparison) -> Drawn:
    """Draw each line's last mean return and success as a dot with its 95 % interval."""
    lines = comparison.lines[::-1]
    figure = style.new_figure(style.TWO_COLUMNS, 0.9 + 0.22 * len(lines))
    returns, success = figure.subplots(1, 2, sharey=True)
    for axes, measure in ((returns, "mean_return"), (success, "success_rate")):
        for row, line in enumerate(lines):
            colour, ends = {"color": line.style.colour}, line.column(-1, measure)
            interval = statistics.bootstrap(statistics.mean, ends)
            axes.plot([interval.low, interval.high], [row, row], **colour)
            axes.plot(ends.mean(axis=1), [row] * len(ends), ".", **colour, markersize=2.5)
            axes.plot(interval.mean, row, line.style.marker, **colour)
    notes = [f"dots: means after the last update; bars: {statistics.INTERVAL}; small dots: seeds"]
    for name, value in comparison.references().items():
        returns.axvline(value, color=style.DARK_GREY, linestyle=_REFERENCES[name])
        notes.append(f"{_REFERENCES[name]} line: {name}")
    success.set(xlabel="success rate", xlim=(-0.03, 1.03))
    success.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    returns.set_yticks(range(len(lines)), [line.label for line in lines])
    returns.set(xlabel=f"mean {lines[0].table.reward} return", ylim=(-0.6, len(lines) - 0.4))
    returns.set_title(comparison.title, loc="left")
    return Drawn(figure, notes)


@style.publication_style()
def plot_profiles(comparison: Comparison) -> Drawn:
    """Draw, for each return, in which share of tasks and seeds a line ends above it."""
    lines = comparison.lines
    figure = style.new_figure(style.TWO_COLUMNS, 2.2)
    axes = figure.subplots()
    thresholds, profiles = statistics.profiles([line.column(-1) for line in lines])
    for line, profile in zip(lines, profiles, strict=True):
        _draw_curve(axes, thresholds, profile.band, line.style, len(line.seeds))
    axes.set_xlabel(f"{lines[0].table.reward} return τ")
    _percent_axis(axes, "tasks that end above τ")
    axes.set_title(comparison.title, loc="left")
    figure.legend(loc="outside right upper")
    return Drawn(figure, [f"bands: {statistics.INTERVAL}", note_on_judging(lines)])


@style.publication_style()
def plot_learning_curves(
    trained: Mapping[MethodStyle, Sequence[LearningCurve]], reward: str
) -> Drawn:
    """Draw success and return over meta-iterations, one line for all seeds of a method.

    A line is the moving average of the mean over seeds; its band is the range of the seeds' own
    moving averages, because three seeds are too few for an interval. A single seed has no band, but
    its raw values behind the line. Seeds are drawn as far as all of a method got.
    """
    figure = style.new_figure(style.TWO_COLUMNS, 2.2)
    panels = figure.subplots(1, 3)
    panels[2].sharey(panels[1])
    metrics = ("success_after", "return_before", "return_after")
    for axes, metric in zip(panels, metrics, strict=True):
        for look, curves in trained.items():
            x = min((curve.iteration for curve in curves), key=len)
            values = np.stack([getattr(curve, metric)[: len(x)] for curve in curves])
            if len(values) == 1:
                axes.plot(x, values[0], color=look.colour, linewidth=0.5, alpha=0.3)
            smooth = moving_mean(values, window_of(len(x)))
            _draw_curve(axes, x, (smooth.mean(0), smooth.min(0), smooth.max(0)), look, len(values))
        axes.set_title(f"{metric.rpartition('_')[2]} the inner update")
        axes.set_xlabel("meta-iteration")
    _percent_axis(panels[0], "success rate")
    panels[1].set_ylabel(f"mean {reward} return")
    _label_lines(figure, panels[2])
    share = f"lines: moving average over {_WINDOW_SHARE:.0%} of the iterations"
    return Drawn(figure, [share, "bands: range over the seeds; thin: iterations of a single seed"])


def window_of(num_iterations: int) -> int:
    """Return over how many iterations curves are averaged; odd, so that it has a centre."""
    return 2 * int(num_iterations * _WINDOW_SHARE / 2) + 1


def moving_mean(
    values: Float[np.ndarray, "seed iteration"], window: int
) -> Float[np.ndarray, "seed iteration"]:
    """Return the centred mean over `window` iterations, over fewer at the ends."""
    ones = np.ones(window)
    counts = np.convolve(np.ones(values.shape[1]), ones, mode="same")
    return np.stack([np.convolve(row, ones, mode="same") for row in values]) / counts


def _draw_curve(
    axes: Axes,
    x: Real[np.ndarray, " point"],
    curve: Sequence[Float[np.ndarray, " point"]],
    look: MethodStyle,
    num_seeds: int,
) -> None:
    """Draw a mean between the ends of its band; the label says if it is that of several seeds."""
    mean, low, high = curve
    axes.fill_between(x, low, high, color=look.colour, alpha=0.18, linewidth=0)
    axes.plot(
        x,
        mean,
        color=look.colour,
        linestyle=look.line,
        marker=look.marker,
        markevery=max(1, len(x) // 6),
        markeredgecolor="white",
        markeredgewidth=0.4,
        label=look.label if num_seeds == 1 else f"{look.label}, {num_seeds} seeds",
    )
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=6, steps=[1, 2, 5, 10]))


def _label_lines(figure: Figure, axes: Axes) -> None:
    """Write each line's label at the right, as near to its end as others leave room."""
    figure.draw_without_rendering()
    named = sorted(
        (_last(line.get_ydata()), str(line.get_color()), textwrap.fill(label, 30))
        for line in axes.lines
        if not (label := str(line.get_label())).startswith("_")
        and np.isfinite(np.asarray(line.get_ydata(), float)).any()
    )
    ends = axes.transData.transform([(0, end) for end, _, _ in named])[:, 1]
    heights = np.array([1.2 * _LABEL_SIZE * (1 + text.count("\n")) for _, _, text in named])
    heights *= figure.dpi / 72
    # The least squares of all displacements: every label above the one before, all beside the axes.
    room = np.cumsum(heights) - heights / 2
    places = scipy.optimize.isotonic_regression(ends - room).x
    places = np.clip(places, axes.bbox.y0, axes.bbox.y1 - heights.sum()) + room
    for (_, colour, text), place in zip(named, places, strict=True):
        at = (1.02, axes.transAxes.inverted().transform((0, place))[1])
        look: Any = {"color": colour, "fontsize": _LABEL_SIZE, "verticalalignment": "center"}
        axes.annotate(text, at, xycoords="axes fraction", annotation_clip=False, **look)


def _last(values: Any) -> float:
    """Return the last number of a curve that may end with what was not measured."""
    known = np.asarray(values, float)
    return float(known[np.isfinite(known)][-1])


def _percent_axis(axes: Axes, label: str) -> None:
    """Let the vertical axis run from 0 to 100 %."""
    axes.set(ylabel=label, ylim=(-0.03, 1.03))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))


def _episodes_axis(axes: Axes, lines: Sequence[Line]) -> None:
    """Count episodes; beyond the shortest update logarithmically, if updates differ in length."""
    lengths = {line.table.episodes_per_update for line in lines} - {None}
    axes.set_xlabel("episodes in the new task")
    if len(lengths) > 1:
        axes.set_xscale("symlog", linthresh=min(filter(None, lengths)), linscale=0.5)
        axes.set_xlim(left=0)
        axes.xaxis.set_major_formatter(ScalarFormatter())
