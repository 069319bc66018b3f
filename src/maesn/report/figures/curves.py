"""What learning curves and adaptation curves have in common."""

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from maesn.report.statistics import Interval
from maesn.report.style import NOTE_SIZE, MethodStyle

_NUM_MARKERS = 6
_BAND_OPACITY = 0.18
_FAINT = 0.35  # opacity of what a method was never trained for
_LEGEND_COLUMNS = 4
_LEGEND_LINE = 0.145  # inches
_LINE_CHARACTERS = 110  # of a note across two columns
_HANDLE_CHARACTERS = 10  # as wide as a legend's sample line and the gap beside it

Values = Float[np.ndarray, " point"]


class Curve(NamedTuple):
    """A line and the two ends of its band."""

    x: Values
    y: Values
    ends: tuple[Values, Values]


def draw_curve(axes: Axes, curve: Curve, style: MethodStyle, num_seeds: int) -> None:
    """Draw a line and its band in its method's style; the label says if it has several seeds."""
    axes.fill_between(curve.x, *curve.ends, color=style.colour, alpha=_BAND_OPACITY, linewidth=0)
    axes.plot(
        curve.x,
        curve.y,
        color=style.colour,
        linestyle=style.line,
        marker=style.marker,
        markevery=max(1, len(curve.x) // _NUM_MARKERS),
        markeredgecolor="white",
        markeredgewidth=0.4,
        label=style.label if num_seeds == 1 else f"{style.label}, {num_seeds} seeds",
    )
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=6, steps=[1, 2, 5, 10]))


def draw_intervals(
    axes: Axes,
    x: Values,
    intervals: Sequence[Interval],
    style: MethodStyle,
    num_seeds: int,
    first_beyond: int | None = None,
) -> str:
    """Draw means with their intervals, and return what the intervals resample.

    Args:
        axes: to draw in.
        x: where each one stands.
        intervals: one for each x.
        style: of the method.
        num_seeds: the label says if there are several.
        first_beyond: index from which on the line is faint, because meta-training has not prepared
            for it; None for no such limit.
    """
    mean, low, high = (
        np.array([getattr(interval, name) for interval in intervals])
        for name in ("mean", "low", "high")
    )
    end = len(x) if first_beyond is None else max(first_beyond, 1)
    draw_curve(axes, Curve(x[:end], mean[:end], (low[:end], high[:end])), style, num_seeds)
    if end < len(x):
        faint = slice(end - 1, None)
        axes.plot(x[faint], mean[faint], color=style.colour, linestyle=":", alpha=_FAINT)
        axes.fill_between(
            x[faint], low[faint], high[faint], color=style.colour, alpha=_FAINT / 4, linewidth=0
        )
    return intervals[0].label


def percent_axis(axes: Axes, label: str) -> None:
    """Let the vertical axis run from 0 to 100 %."""
    axes.set_ylabel(label)
    axes.set_ylim(-0.03, 1.03)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))


def note_on_bands(labels: Mapping[str, str]) -> list[str]:
    """Say what the bands are, once for all lines of which it is the same.

    Args:
        labels: what the band of each line resamples, by the line's label.
    """
    members: dict[str, list[str]] = {}
    for name, label in labels.items():
        members.setdefault(label, []).append(name)
    *exceptions, rule = sorted(members, key=lambda label: len(members[label]))
    others = [f"bands of {', '.join(members[label])}: {label}" for label in exceptions]
    return [*others, f"{'other bands' if others else 'bands'}: {rule}"]


def note_on_trials(label: str, trial_episodes: int | None, first_beyond: int | None) -> list[str]:
    """Say of a line why its end is faint, if it is."""
    if first_beyond is None:
        return []
    return [f"{label}, faint: beyond the {trial_episodes} episodes that it was trained for"]


def explain(figure: Figure, axes: Axes, note: str, line_characters: int = _LINE_CHARACTERS) -> None:
    """Put a note and the legend of one panel below all panels; the figure grows by their height.

    Args:
        figure: to write in.
        axes: the panel of which the legend is.
        note: what else is to be said.
        line_characters: as many fit across the figure.
    """
    handles, labels = axes.get_legend_handles_labels()
    fitting = line_characters // (max(map(len, labels)) + _HANDLE_CHARACTERS)
    columns = max(1, min(len(labels), _LEGEND_COLUMNS, fitting))
    note = "\n".join(textwrap.fill(line, line_characters) for line in note.splitlines())
    legend = figure.legend(handles, labels, loc="outside lower center", ncols=columns, title=note)
    legend.get_title().set_fontsize(NOTE_SIZE)
    legend.get_title().set_multialignment("center")
    lines = math.ceil(len(labels) / columns) + note.count("\n") + 1
    figure.set_figheight(figure.get_figheight() + _LEGEND_LINE * lines)
