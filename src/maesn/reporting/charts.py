"""Charts: what curves show, for the figures and for the page, which draw them in their own ways."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from maesn.reporting import statistics
from maesn.reporting.comparison import Comparison, Line
from maesn.reporting.runs import LearningCurve, RecordedBelief
from maesn.reporting.sources import Series
from maesn.reporting.style import DARK_GREY, METHOD_STYLES, MethodStyle

# Every iteration draws other tasks, so single ones scatter. A window of 1/30 of the run halves the
# scatter of 100 iterations at the price of 3 % of the horizontal resolution.
WINDOW_SHARE = 1 / 30

REFERENCES = {"baseline": ":", "oracle": "-"}  # lines of their mean returns


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


def adaptation_charts(comparison: Comparison) -> list[Chart]:
    """Return return and success over the episodes that were learned from in the new task.

    Horizontal lines are the mean returns of baseline and oracle, circles the published curve.
    """
    lines = comparison.lines
    lengths = {line.table.episodes_per_update for line in lines} - {None}
    shortest = min(filter(None, lengths)) if len(lengths) > 1 else None
    returns, success = (
        [_curve(line, line.table.episodes, statistics.curve(line.measure(name))) for line in lines]
        for name in ("mean_return", "success_rate")
    )
    returns += [_published(line) for line in lines if line.published is not None]
    ends = np.array([0, max(line.table.episodes[-1] for line in lines)])
    for name, value in comparison.references().items():
        style = MethodStyle(name, DARK_GREY, REFERENCES[name], "")
        returns.append(Curve(style, ends, np.full(2, value)))
    x, y = "episodes in the new task", f"mean {lines[0].table.reward} return"
    return [
        Chart(x, y, returns, linear_to=shortest),
        Chart(x, "success rate", success, is_share=True, linear_to=shortest),
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
        if trained:
            found[reward] = [
                Chart(
                    "meta-iteration",
                    y,
                    [_learning_curve(style, metric, seeds) for style, seeds in trained],
                    title=f"{metric.rpartition('_')[2]} the inner update",
                    is_share=metric == "success_after",
                )
                for metric, y in measures.items()
            ]
    return found


def belief_chart(belief: RecordedBelief) -> Chart:
    """Return the posterior's mean over a trial, a line and a band of ± its spread a component."""
    colours = [style.colour for style in METHOD_STYLES.values()]
    curves = [
        Curve(MethodStyle(f"m{number}", colour, "-", ""), belief.step, mean, mean - std, mean + std)
        for number, (mean, std, colour) in enumerate(
            zip(belief.mean.T, belief.std.T, cycle(colours)), start=1
        )
    ]
    return Chart("steps of the trial", "posterior mean ± spread", curves)


def moving_mean(
    values: Float[np.ndarray, "seed iteration"], window: int
) -> Float[np.ndarray, "seed iteration"]:
    """Return the centred mean over `window` iterations, over fewer at the ends."""
    ones = np.ones(window)
    counts = np.convolve(np.ones(values.shape[1]), ones, mode="same")
    return np.stack([np.convolve(row, ones, mode="same") for row in values]) / counts


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
