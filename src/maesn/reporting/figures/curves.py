"""Methods in new tasks: their curves, where they end, and in which share of tasks above what."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy.optimize
from jaxtyping import Float, Real
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, PercentFormatter, ScalarFormatter

from maesn.reporting import statistics, style
from maesn.reporting.comparison import Comparison, Line, by_line, note_on_judging
from maesn.reporting.style import Drawn, MethodStyle

_NUM_MARKERS = 6
_BAND_OPACITY = 0.18
_FAINT = 0.35  # opacity of what a method was never trained for
_MOST_COLOURED = 5  # lines; more cannot be told apart by colour
_LABEL_CHARACTERS = 30  # of a line of a label
_LABEL_SIZE = 6.5  # points
_WIDTHS = (1.5, 1.0)  # return, success
_ROW = 0.22  # inches
_HOLLOW = {"markersize": 3.0, "markerfacecolor": "none", "markeredgewidth": 0.6}
# How the mean returns of those who learn nothing, or are given the task, are drawn.
_REFERENCES = {
    "baseline": {"color": style.DARK_GREY, "linewidth": 0.8, "linestyle": (0, (1.0, 1.5))},
    "oracle": {"color": style.DARK_GREY, "linewidth": 0.8, "linestyle": "-"},
}


@style.publication_style()
def plot_curves(comparison: Comparison) -> Drawn:
    """Draw return and success over the episodes that were learned from in the new task.

    The curve of a policy with recurrent state is faint beyond the trials that it was trained on.
    Horizontal lines are the mean returns of baseline and oracle, circles the published curve.
    """
    figure = style.new_figure(style.TWO_COLUMNS, 2.5)
    returns, success = figure.subplots(1, 2, width_ratios=_WIDTHS)
    lines, labels = list(comparison.lines), {}
    for position, line in enumerate(lines[_MOST_COLOURED:], start=_MOST_COLOURED):
        lines[position] = replace(line, style=replace(line.style, colour=style.GREY))
    for axes, measure in ((returns, "mean_return"), (success, "success_rate")):
        for line in lines:
            found = statistics.curve(line.measure(measure))
            labels[line.label] = found.label
            x, first_beyond = line.table.episodes, line.table.first_beyond
            draw_curve(axes, x, found.band, line.style, len(line.seeds), first_beyond)
        _episodes_axis(axes, lines)
    for name, value in comparison.references().items():
        returns.axhline(value, label=name, **_REFERENCES[name])
    published = [(one, curve) for one in lines if (curve := one.published) is not None]
    for line, curve in published:
        episodes = curve.update * (line.table.episodes_per_update or 1)
        shown = episodes <= line.table.episodes[-1]
        look = {"markeredgecolor": line.style.colour, **_HOLLOW}
        returns.plot(episodes[shown], curve.mean_return[shown], "o", **look)
    returns.set_ylabel(f"mean {lines[0].table.reward} return")
    percent_axis(success, "success rate")
    figure.suptitle(comparison.title)
    label_lines(returns)
    circles = ["circles: as published"] if published else []
    return Drawn(figure, [*_notes(lines, labels), *circles])


@style.publication_style()
def plot_ends(comparison: Comparison) -> Drawn:
    """Draw each line's last mean return and success as a dot with its 95 % interval."""
    lines = comparison.lines[::-1]
    figure = style.new_figure(style.TWO_COLUMNS, 0.9 + _ROW * len(lines))
    returns, success = figure.subplots(1, 2, sharey=True)
    for row, line in enumerate(lines):
        _draw_end(returns, row, line, line.column(-1))
        _draw_end(success, row, line, 100 * line.column(-1, "success_rate"))
    for name, value in comparison.references().items():
        returns.axvline(value, **_REFERENCES[name])
    for axes in (returns, success):
        axes.grid(axis="x", linewidth=0.3)
    returns.set_xlabel(f"mean {lines[0].table.reward} return")
    success.set_xlabel("reaches goal (%)")
    returns.set_yticks(range(len(lines)), [line.label for line in lines])
    returns.set_ylim(-0.6, len(lines) - 0.4)
    figure.suptitle(comparison.title)
    return Drawn(
        figure, ["dots: means after the last update; bars: 95 % intervals; small dots: seeds"]
    )


def _draw_end(axes: Axes, row: int, line: Line, ends: Float[np.ndarray, "seed task"]) -> None:
    """Draw one dot, its interval, and a small dot for each seed."""
    colour, interval = line.style.colour, statistics.bootstrap(statistics.mean, ends)
    if interval.is_known:
        axes.plot([interval.low, interval.high], [row, row], color=colour)
    if len(ends) > 1:
        axes.plot(ends.mean(axis=1), np.full(len(ends), row), ".", color=colour, markersize=2.5)
    axes.plot(interval.mean, row, line.style.marker, color=colour)


@style.publication_style()
def plot_profiles(comparison: Comparison) -> Drawn:
    """Draw, for each return, in which share of tasks and seeds a line ends above it."""
    lines, labels = comparison.lines, {}
    figure = style.new_figure(style.TWO_COLUMNS, 2.2)
    axes = figure.subplots()
    thresholds, profiles = statistics.profiles([line.column(-1) for line in lines])
    for line, profile in zip(lines, profiles, strict=True):
        draw_curve(axes, thresholds, profile.band, line.style, len(line.seeds))
        labels[line.label] = profile.label
    axes.set_xlabel(f"{lines[0].table.reward} return τ")
    percent_axis(axes, "tasks that end above τ")
    figure.suptitle(comparison.title)
    figure.legend(loc="outside right upper")
    return Drawn(figure, _notes(lines, labels))


def draw_curve(
    axes: Axes,
    x: Real[np.ndarray, " point"],
    curve: Sequence[Float[np.ndarray, " point"]],
    look: MethodStyle,
    num_seeds: int,
    first_beyond: int | None = None,
) -> None:
    """Draw a mean between the ends of its band; the label says if it is that of several seeds.

    From `first_beyond` on, what meta-training has not prepared a method for is faint.
    """
    end = len(x) if first_beyond is None else max(first_beyond, 1)
    mean, low, high = (one[:end] for one in curve)
    axes.fill_between(x[:end], low, high, color=look.colour, alpha=_BAND_OPACITY, linewidth=0)
    axes.plot(
        x[:end],
        mean,
        color=look.colour,
        linestyle=look.line,
        marker=look.marker,
        markevery=max(1, end // _NUM_MARKERS),
        markeredgecolor="white",
        markeredgewidth=0.4,
        label=look.label if num_seeds == 1 else f"{look.label}, {num_seeds} seeds",
    )
    if end < len(x):
        x, mean, low, high = (one[end - 1 :] for one in (x, *curve))
        axes.plot(x, mean, color=look.colour, linestyle=":", alpha=_FAINT)
        axes.fill_between(x, low, high, color=look.colour, alpha=_FAINT / 4, linewidth=0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=6, steps=[1, 2, 5, 10]))


def label_lines(axes: Axes) -> None:
    """Write each line's label at the right, as near to its end as others leave room."""
    figure = axes.figure
    figure.draw_without_rendering()  # type: ignore[union-attr]
    named = [one for one in axes.lines if not str(one.get_label()).startswith("_")]
    ends_of = {one: float(np.asarray(one.get_ydata())[-1]) for one in named}
    lines = sorted(named, key=ends_of.__getitem__)
    texts = [textwrap.fill(str(one.get_label()), _LABEL_CHARACTERS) for one in lines]
    ends = axes.transData.transform([(0, ends_of[one]) for one in lines])[:, 1]
    heights = np.array([1.2 * _LABEL_SIZE * (1 + text.count("\n")) for text in texts])
    heights *= figure.dpi / 72
    # The least squares of all displacements, with every label above the one before.
    room = np.cumsum(heights) - heights / 2
    places = scipy.optimize.isotonic_regression(ends - room).x + room
    for line, text, place in zip(lines, texts, places, strict=True):
        (_, height) = axes.transAxes.inverted().transform((0, place))
        axes.annotate(
            text,
            (1, height),
            xycoords="axes fraction",
            xytext=(3, 0),
            textcoords="offset points",
            color=line.get_color(),
            fontsize=_LABEL_SIZE,
            verticalalignment="center",
            annotation_clip=False,
        )


def percent_axis(axes: Axes, label: str) -> None:
    """Let the vertical axis run from 0 to 100 %."""
    axes.set(ylabel=label, ylim=(-0.03, 1.03))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))


def _notes(lines: Sequence[Line], bands: Mapping[str, str]) -> list[str]:
    """Say what the bands of lines resample, what is judged, what is faint, who has fewer tasks."""
    most = max(line.num_tasks for line in lines)
    faint = [f"faint: {line.beyond}" for line in lines if line.beyond]
    fewer = [
        f"{line.label}: the first {line.num_tasks} of {most} tasks alone"
        for line in lines
        if line.num_tasks < most
    ]
    return [f"bands: {by_line(bands)}", note_on_judging(lines), *faint, *fewer]


def _episodes_axis(axes: Axes, lines: Sequence[Line]) -> None:
    """Count episodes; beyond the shortest update logarithmically, if updates differ in length."""
    lengths = {line.table.episodes_per_update for line in lines} - {None}
    axes.set_xlabel("episodes in the new task")
    if len(lengths) > 1:
        axes.set_xscale("symlog", linthresh=min(filter(None, lengths)), linscale=0.5)
        axes.set_xlim(left=0)
        axes.xaxis.set_major_formatter(ScalarFormatter())
