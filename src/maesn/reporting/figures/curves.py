"""Curves of meta-training and of methods in new tasks, and where these end."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter, ScalarFormatter

from maesn.reporting import statistics, style
from maesn.reporting.comparison import Comparison, Line
from maesn.reporting.runs import LearningCurve
from maesn.reporting.sources import Series
from maesn.reporting.style import DARK_GREY, METHOD_STYLES, MethodStyle

# Every iteration draws other tasks, so single ones scatter. A window of 1/30 of the run halves the
# scatter of 100 iterations at the price of 3 % of the horizontal resolution.
WINDOW_SHARE = 1 / 30

REFERENCES = {"baseline": ":", "oracle": "-"}  # lines of their mean returns
_COLUMNS = 3  # in a legend
_SHORT = 22  # characters of a label, two of which stand side by side in one column of a page


class Curve(NamedTuple):
    """A curve, `[point]` each; without `low` and `high` it has no band."""

    style: MethodStyle  # one without a line is drawn as circles
    x: Any
    mean: Any
    low: Any = None
    high: Any = None
    raw: Any = None  # what `mean` is the moving average of, for a single seed


class Chart(NamedTuple):
    """Curves over one axis."""

    x: str
    y: str
    curves: Sequence[Curve]
    title: str = ""
    is_share: bool = False  # whether the vertical axis runs from 0 to 1
    linear_to: int | None = None  # from there on the horizontal axis is logarithmic

    @property
    def is_known(self) -> bool:
        """Whether there is anything to draw: a method or a family may have no such number."""
        return any(np.isfinite(np.asarray(curve.mean, float)).any() for curve in self.curves)


def adaptation_charts(comparison: Comparison) -> list[Chart]:
    """Return return and success over the episodes that were learned from in the new task.

    Horizontal lines are the mean returns of baseline and oracle, circles the published curve.
    """
    lines = comparison.lines
    lengths = {line.table.episodes_per_update for line in lines} - {None}
    shortest = min(filter(None, lengths)) if len(lengths) > 1 else None
    returns, *success = (
        [_curve(line, line.table.episodes, statistics.curve(line.measure(name))) for line in lines]
        for name in comparison.headline_measures
    )
    returns += [_published(line) for line in lines if line.published is not None]
    ends = np.array([0, max(line.table.episodes[-1] for line in lines)])
    for name, value in comparison.references().items():
        style = MethodStyle(name, DARK_GREY, REFERENCES[name], "")
        returns.append(Curve(style, ends, np.full(2, value)))
    x, y = "episodes in the new task", f"mean {lines[0].table.reward} return"
    return [
        Chart(x, y, returns, linear_to=shortest),
        *(Chart(x, "success rate", one, is_share=True, linear_to=shortest) for one in success),
    ]


def profile_chart(comparison: Comparison) -> Chart:
    """Return, for each return, in which share of tasks and seeds a line ends above it."""
    lines = comparison.lines
    thresholds, profiles = statistics.profiles([line.column(-1) for line in lines])
    curves = [_curve(line, thresholds, one) for line, one in zip(lines, profiles, strict=True)]
    x = f"{lines[0].table.reward} return τ"
    return Chart(x, "tasks that end above τ", curves, is_share=True)


def learning_charts(series: Sequence[Series]) -> dict[str, list[Chart]]:
    """Return success and return over meta-iterations, by reward: returns have no common axis.

    A line is the moving average of the mean over a method's seeds; its band is the range of the
    seeds' own moving averages, because three seeds are too few for an interval. Seeds are drawn as
    far as all of a method got. Runs that have not finished an iteration are left out.
    """
    found = {}
    for reward in ("dense", "sparse"):
        of_reward = [one for one in series if one.runs[0].settings["reward"] == reward]
        trained = [(one.style, seeds) for one in of_reward if (seeds := one.learning_curves())]
        measures = {
            "success_after": "success rate",
            "return_before": f"mean {reward} return",
            "return_after": f"mean {reward} return",
        }
        charts = (
            Chart(
                "meta-iteration",
                y,
                [_learning_curve(style, metric, seeds) for style, seeds in trained],
                title=f"{metric.rpartition('_')[2]} the inner update",
                is_share=metric == "success_after",
            )
            for metric, y in measures.items()
        )
        if known := [chart for chart in charts if chart.is_known]:
            found[reward] = known
    return found


def belief_chart(belief: Mapping[str, Any]) -> Chart:
    """Return the posterior's mean over a trial, a line and a band of ± its spread a component."""
    colours = [style.colour for style in METHOD_STYLES.values()]
    means, stds = (np.array(belief[name], float).T for name in ("mean", "std"))
    curves = [
        Curve(MethodStyle(f"m{n}", colour, "-", ""), belief["step"], mean, mean - std, mean + std)
        for n, (mean, std, colour) in enumerate(zip(means, stds, cycle(colours)), start=1)
    ]
    return Chart("steps of the trial", "posterior mean ± spread", curves)


def moving_mean(
    values: Float[np.ndarray, "seed iteration"], window: int
) -> Float[np.ndarray, "seed iteration"]:
    """Return the centred mean over `window` iterations, over fewer at the ends."""
    ones = np.ones(window)
    counts = np.convolve(np.ones(values.shape[1]), ones, mode="same")
    return np.stack([np.convolve(row, ones, mode="same") for row in values]) / counts


def plot_curves(comparison: Comparison) -> Figure:
    """Draw return and success over the episodes in the new task."""
    return plot_charts(adaptation_charts(comparison), comparison.title)


def plot_profiles(comparison: Comparison) -> Figure:
    """Draw, for each return, in which share of tasks and seeds a line ends above it."""
    return plot_charts([profile_chart(comparison)], comparison.title)


@style.publication_style()
def plot_ends(comparison: Comparison) -> Figure:
    """Draw each line's last mean return and success as a dot with its 95 % interval.

    Small dots are seeds, vertical lines baseline (dotted) and oracle.
    """
    lines = comparison.lines[::-1]
    figure = style.new_figure(style.TWO_COLUMNS, 0.9 + 0.22 * len(lines))
    measures = comparison.headline_measures
    panels = figure.subplots(1, len(measures), sharey=True, squeeze=False)[0]
    drawn = dict(zip(measures, panels, strict=True))
    for measure, axes in drawn.items():
        for row, line in enumerate(lines):
            colour, ends = {"color": line.style.colour}, line.column(-1, measure)
            interval = statistics.bootstrap(statistics.mean, ends)
            axes.plot([interval.low, interval.high], [row, row], **colour)
            axes.plot(ends.mean(axis=1), [row] * len(ends), ".", **colour, markersize=2.5)
            axes.plot(interval.mean, row, line.style.marker, **colour)
    returns = drawn["mean_return"]
    for name, value in comparison.references().items():
        returns.axvline(value, color=DARK_GREY, linestyle=REFERENCES[name])
    if success := drawn.get("success_rate"):
        success.set(xlabel="success rate", xlim=(-0.03, 1.03))
        success.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    returns.set_yticks(range(len(lines)), [line.label for line in lines])
    returns.set(xlabel=f"mean {lines[0].table.reward} return", ylim=(-0.6, len(lines) - 0.4))
    returns.set_title(comparison.title, loc="left")
    return figure


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


def _learning_curve(style: MethodStyle, metric: str, seeds: Sequence[LearningCurve]) -> Curve:
    x = min((seed.iteration for seed in seeds), key=len)
    values = np.stack([getattr(seed, metric)[: len(x)] for seed in seeds])
    # Odd, so that the window has a centre.
    smooth = moving_mean(values, 2 * int(len(x) * WINDOW_SHARE / 2) + 1)
    raw = values[0] if len(seeds) == 1 else None
    band = (smooth.mean(0), smooth.min(0), smooth.max(0))
    return Curve(_counted(style, len(seeds)), x, *band, raw)


def _curve(line: Line, x: Any, interval: statistics.Interval) -> Curve:
    return Curve(_counted(line.style, len(line.seeds)), x, *interval.band)


def _counted(style: MethodStyle, num_seeds: int) -> MethodStyle:
    return style if num_seeds == 1 else replace(style, label=f"{style.label}, {num_seeds} seeds")


def _published(line: Line) -> Curve:
    assert line.published is not None
    episodes = line.published.update * (line.table.episodes_per_update or 1)
    shown = episodes <= line.table.episodes[-1]
    style = replace(line.style, label=f"{line.label}, published", line="", marker="o")
    return Curve(style, episodes[shown], line.published.mean_return[shown])
