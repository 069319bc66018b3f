"""Curves of meta-training and of methods in new tasks, and where these end."""

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter, ScalarFormatter

from maesn.reporting import statistics, style
from maesn.reporting.charts import (
    REFERENCES,
    WINDOW_SHARE,
    Chart,
    Curve,
    adaptation_charts,
    profile_chart,
)
from maesn.reporting.comparison import Comparison, note_on_judging
from maesn.reporting.style import Drawn

_COLUMNS = 3  # in a legend
_SHORT = 22  # characters of a label, two of which stand side by side in one column of a page


def plot_curves(comparison: Comparison) -> Drawn:
    """Draw return and success over the episodes in the new task."""
    lines = comparison.lines
    most = max(line.num_tasks for line in lines)
    fewer = [line for line in lines if line.num_tasks < most]
    notes = [
        f"bands: {statistics.INTERVAL}; circles: as published, where the paper shows the method",
        note_on_judging(lines),
        *(line.beyond for line in lines if line.beyond),
        *(f"{line.label}: the first {line.num_tasks} of {most} tasks alone" for line in fewer),
    ]
    return Drawn(plot_charts(adaptation_charts(comparison), comparison.title), notes)


def plot_profiles(comparison: Comparison) -> Drawn:
    """Draw, for each return, in which share of tasks and seeds a line ends above it."""
    figure = plot_charts([profile_chart(comparison)], comparison.title)
    return Drawn(figure, [f"bands: {statistics.INTERVAL}", note_on_judging(comparison.lines)])


def plot_learning_curves(charts: Sequence[Chart]) -> Drawn:
    """Draw meta-training; the iterations of a single seed lie behind its line."""
    share = f"lines: moving average over {WINDOW_SHARE:.0%} of the iterations"
    notes = [share, "bands: range over the seeds; thin: iterations of a single seed"]
    return Drawn(plot_charts(charts), notes)


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
        returns.axvline(value, color=style.DARK_GREY, linestyle=REFERENCES[name])
        notes.append(f"{'dotted' if REFERENCES[name] == ':' else 'solid'} line: {name}")
    success.set(xlabel="success rate", xlim=(-0.03, 1.03))
    success.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    returns.set_yticks(range(len(lines)), [line.label for line in lines])
    returns.set(xlabel=f"mean {lines[0].table.reward} return", ylim=(-0.6, len(lines) - 0.4))
    returns.set_title(comparison.title, loc="left")
    return Drawn(figure, notes)


@style.publication_style()
def plot_charts(
    charts: Sequence[Chart], title: str = "", width: float = style.TWO_COLUMNS
) -> Figure:
    """Draw charts side by side, with a common legend below; those of one measure share its axis."""
    curves = {curve.style.label: curve for chart in charts for curve in chart.curves}
    named = [label for label, curve in curves.items() if curve.style.line]
    is_short = max(map(len, named), default=0) < _SHORT
    columns = _COLUMNS if width > style.ONE_COLUMN else 1 + is_short
    figure = style.new_figure(width, 2.2 + 0.15 * -(-len(named) // columns))
    panels = figure.subplots(1, len(charts), squeeze=False)[0].tolist()
    measures: dict[str, Axes] = {}
    for axes, chart in zip(panels, charts, strict=True):
        axes.set(xlabel=chart.x, ylabel=chart.y, title=chart.title)
        if chart.linear_to:
            axes.set_xscale("symlog", linthresh=chart.linear_to, linscale=0.5)
            axes.xaxis.set_major_formatter(ScalarFormatter())
        else:
            axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=6, steps=[1, 2, 5, 10]))
        for curve in chart.curves:
            _draw_curve(axes, curve)
        if chart.linear_to:
            axes.set_xlim(left=0)
        if chart.is_share:
            axes.set_ylim(-0.03, 1.03)
            axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        elif chart.y in measures:
            axes.sharey(measures[chart.y])
        measures.setdefault(chart.y, axes)
    if title:
        panels[0].set_title(title, loc="left")
    known: dict[str, Artist] = {}
    for axes in panels:
        handles, labels = axes.get_legend_handles_labels()
        known |= zip(labels, handles, strict=True)
    figure.legend(known.values(), known.keys(), loc="outside lower center", ncols=columns)
    return figure


def _draw_curve(axes: Axes, curve: Curve) -> None:
    """Draw a mean between the ends of its band, or circles where the style has no line."""
    x, look = curve.x, curve.style
    if not look.line:
        axes.plot(x, curve.mean, look.marker, color=look.colour, fillstyle="none", markersize=3)
        return
    if curve.raw is not None:
        axes.plot(x, curve.raw, color=look.colour, linewidth=0.5, alpha=0.3)
    if curve.low is not None:
        axes.fill_between(x, curve.low, curve.high, color=look.colour, alpha=0.18, linewidth=0)
    if np.isfinite(np.asarray(curve.mean, float)).any():
        axes.plot(
            x,
            curve.mean,
            color=look.colour,
            linestyle=look.line,
            marker=look.marker,
            markevery=max(1, len(x) // 6),
            markeredgecolor="white",
            markeredgewidth=0.4,
            label=look.label,
        )
