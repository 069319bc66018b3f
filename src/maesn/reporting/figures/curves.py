"""Curves over the episodes of a new task, and what all figures of lines have in common."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy.optimize
from jaxtyping import Float, Real
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, PercentFormatter, ScalarFormatter

from maesn.reporting.adaptation_table import Line, by_text, note_on_judging
from maesn.reporting.published import PublishedCurve
from maesn.reporting.statistics import mean_intervals
from maesn.reporting.style import (
    DARK_GREY,
    GREY,
    TWO_COLUMNS,
    Drawn,
    MethodStyle,
    new_figure,
    publication_style,
)

_NUM_MARKERS = 6
_BAND_OPACITY = 0.18
_FAINT = 0.35  # opacity of what a method was never trained for
_MOST_COLOURED = 5  # lines; more cannot be told apart by colour
_LABEL_CHARACTERS = 30  # of a line of a label
_LABEL_SIZE = 6.5  # points
_LABEL_LINE = 1.2 * _LABEL_SIZE
_WIDTHS = (1.5, 1.0)  # return, success
_REFERENCES = {"baseline": (0, (1.0, 1.5)), "oracle": "-"}
_NONE: Mapping[str, PublishedCurve | None] = MappingProxyType({})

Curve = Float[np.ndarray, "mean_low_high point"]
"""A line and the ends of its band."""


@publication_style()
def plot_curves(
    lines: Sequence[Line],
    title: str,
    references: Mapping[str, float | None] = MappingProxyType({}),
    published: Mapping[str, PublishedCurve | None] = _NONE,
) -> Drawn:
    """Draw return and success over the episodes that were learned from in the new task.

    The curve of a policy with recurrent state is faint beyond the trials that it was trained on.

    Args:
        lines: on the same tasks and reward.
        title: of the figure.
        references: `baseline` and `oracle` -> their mean return, drawn as a horizontal line.
        published: name of a line -> the published curve of its method, drawn as open circles.
    """
    figure = new_figure(TWO_COLUMNS, 2.5)
    returns, success = figure.subplots(1, 2, width_ratios=_WIDTHS)
    lines = [*lines[:_MOST_COLOURED], *map(_grey, lines[_MOST_COLOURED:])]
    labels = {}
    for axes, measure in ((returns, "mean_return"), (success, "success_rate")):
        for line in lines:
            labels[line.label] = draw_line(axes, line.table.episodes, line, measure)
        _episodes_axis(axes, lines)
    notes = note_on_lines(lines, labels)
    for name, value in references.items():
        if value is not None:
            drawn = returns.axhline(value, color=DARK_GREY, linewidth=0.8, label=name)
            drawn.set_linestyle(_REFERENCES[name])
    if any(_draw_published(returns, line, published.get(line.name)) for line in lines):
        notes.append("circles: as published")
    returns.set_ylabel(f"mean {lines[0].table.reward} return")
    percent_axis(success, "success rate")
    figure.suptitle(title)
    label_lines(returns)
    return Drawn(figure, notes)


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


def draw_line(axes: Axes, x: Real[np.ndarray, " point"], line: Line, measure: str) -> str:
    """Draw the mean of a measure with its intervals, and return what the intervals resample.

    Each column of the line's tables stands at its `x`. What meta-training has not prepared a method
    for is faint.
    """
    intervals = mean_intervals(line.measure(measure))
    curve = np.array([(one.mean, one.low, one.high) for one in intervals]).T
    style, beyond = replace(line.style, label=line.label), line.table.first_beyond
    end = len(x) if beyond is None else max(beyond, 1)
    draw_curve(axes, x[:end], curve[:, :end], style, len(line.seeds))
    if end < len(x):
        x, (mean, *ends) = x[end - 1 :], curve[:, end - 1 :]
        axes.plot(x, mean, color=style.colour, linestyle=":", alpha=_FAINT)
        axes.fill_between(x, *ends, color=style.colour, alpha=_FAINT / 4, linewidth=0)
    return intervals[0].label


def label_lines(axes: Axes) -> None:
    """Write each line's label at the right, as near to its end as others leave room."""
    figure = axes.figure
    figure.draw_without_rendering()  # type: ignore[union-attr]
    named = [one for one in axes.lines if not str(one.get_label()).startswith("_")]
    ends_of = {one: float(np.asarray(one.get_ydata())[-1]) for one in named}
    lines = sorted(named, key=ends_of.__getitem__)
    texts = [textwrap.fill(str(one.get_label()), _LABEL_CHARACTERS) for one in lines]
    ends = axes.transData.transform([(0, ends_of[one]) for one in lines])[:, 1]
    heights = np.array([_LABEL_LINE * (1 + text.count("\n")) for text in texts])
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


def _grey(line: Line) -> Line:
    return replace(line, style=replace(line.style, colour=GREY))


def percent_axis(axes: Axes, label: str) -> None:
    """Let the vertical axis run from 0 to 100 %."""
    axes.set(ylabel=label, ylim=(-0.03, 1.03))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))


def note_on_lines(lines: Sequence[Line], labels: Mapping[str, str]) -> list[str]:
    """Say what the bands are, which episodes are judged, what is faint, who has fewer tasks.

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
    most = max(line.num_tasks for line in lines)
    fewer = [
        f"{line.label}: the first {line.num_tasks} of {most} tasks alone"
        for line in lines
        if line.num_tasks < most
    ]
    return [*bands, note_on_judging(lines), *faint, *fewer]


def _draw_published(axes: Axes, line: Line, curve: PublishedCurve | None) -> bool:
    """Mark the published returns as far as ours go; return whether there are any."""
    if curve is None:
        return False
    episodes = curve.update * (line.table.episodes_per_update or 1)
    shown = episodes <= line.table.episodes[-1]
    marks: dict[str, Any] = {"markersize": 3.0, "markerfacecolor": "none", "markeredgewidth": 0.6}
    axes.plot(
        episodes[shown], curve.mean_return[shown], "o", markeredgecolor=line.style.colour, **marks
    )
    return True


def _episodes_axis(axes: Axes, lines: Sequence[Line]) -> None:
    """Count episodes; beyond the shortest update logarithmically, if updates differ in length."""
    shortest = {line.table.episodes_per_update for line in lines} - {None}
    axes.set_xlabel("episodes in the new task")
    if len(shortest) > 1:
        axes.set_xscale("symlog", linthresh=min(filter(None, shortest)), linscale=0.5)
        axes.set_xlim(left=0)
        axes.xaxis.set_major_formatter(ScalarFormatter())
