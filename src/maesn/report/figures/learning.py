"""Learning curves of meta-training, before and after the inner update."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from maesn.report.figures.curves import Curve, draw_curve, explain, percent_axis
from maesn.report.runs import LearningCurve
from maesn.report.series import Series
from maesn.report.style import TWO_COLUMNS, MethodStyle, new_figure, publication_style

_HEIGHT = 2.05  # inches, without the legend
# Every iteration draws other tasks, so single ones scatter. A window of 1/30 of the run halves the
# scatter of 100 iterations at the price of 3 % of the horizontal resolution.
_WINDOW_SHARE = 1 / 30

_METRICS = ("return_before", "return_after", "success_after")
_TITLES = ("before the inner update", "after the inner update", "after the inner update")


@dataclass(frozen=True)
class TrainedSeries:
    """A series and the learning curves of its seeds."""

    series: Series
    curves: tuple[LearningCurve, ...]

    def seeds(
        self, metric: str
    ) -> tuple[Float[np.ndarray, " iteration"], Float[np.ndarray, "seed iteration"]]:
        """Return the iterations that every seed has finished, and a metric there."""
        length = min(len(curve.iteration) for curve in self.curves)
        values = np.stack([getattr(curve, metric)[:length] for curve in self.curves])
        return self.curves[0].iteration[:length], values


@publication_style()
def plot_learning_curves(trained: Sequence[TrainedSeries], reward: str) -> Figure:
    """Draw return and success over meta-iterations, one line per series.

    A line is the moving average of the mean over seeds; its band is the range of the seeds' own
    moving averages, because three seeds are too few for an interval. A single seed has no band, but
    its raw values behind the line.

    Args:
        trained: what to draw; seeds are drawn as far as all of a series got.
        reward: that was trained on, "dense" or "sparse", for the axis.
    """
    figure = new_figure(TWO_COLUMNS, _HEIGHT)
    panels = figure.subplots(1, 3)
    panels[1].sharey(panels[0])
    for axes, metric, title in zip(panels, _METRICS, _TITLES, strict=True):
        for line in trained:
            _draw_seeds(axes, *line.seeds(metric), line.series.style)
        axes.set_title(title)
        axes.set_xlabel("meta-iteration")
    panels[0].set_ylabel(f"mean {reward} return")
    percent_axis(panels[2], "success rate")
    explain(figure, panels[1], _note(trained))
    return figure


def moving_mean(
    values: Float[np.ndarray, "seed iteration"], window: int
) -> Float[np.ndarray, "seed iteration"]:
    """Return the centred mean over `window` iterations, over fewer at the ends."""
    ones = np.ones(window)
    counts = np.convolve(np.ones(values.shape[1]), ones, mode="same")
    return np.stack([np.convolve(row, ones, mode="same") for row in values]) / counts


def _window(num_iterations: int) -> int:
    """Return an odd number of iterations, so that the window has a centre."""
    return 2 * int(num_iterations * _WINDOW_SHARE / 2) + 1


def _draw_seeds(
    axes: Axes,
    iteration: Float[np.ndarray, " iteration"],
    values: Float[np.ndarray, "seed iteration"],
    style: MethodStyle,
) -> None:
    if np.isnan(values).all():
        return
    smooth = moving_mean(values, _window(len(iteration)))
    if len(values) == 1:
        axes.plot(iteration, values[0], color=style.colour, linewidth=0.5, alpha=0.3)
    ends = (smooth.min(0), smooth.max(0))
    draw_curve(axes, Curve(iteration, smooth.mean(0), ends), style, num_seeds=len(values))


def _note(trained: Sequence[TrainedSeries]) -> str:
    """Say what lines and bands are."""
    windows = sorted({_window(len(line.seeds("return_after")[0])) for line in trained})
    averaged = f"lines: moving average over {' or '.join(map(str, windows))} iterations"
    notes = {
        averaged: windows[-1] > 1,
        "thin: single iterations": any(len(line.curves) == 1 for line in trained),
        "bands: range over the seeds": any(len(line.curves) > 1 for line in trained),
    }
    return "; ".join(note for note, applies in notes.items() if applies)
