"""Learning curves of meta-training, before and after the inner update."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from maesn.report.figures.curves import draw_curve, explain, percent_axis
from maesn.report.runs import LearningCurve
from maesn.report.style import TWO_COLUMNS, MethodStyle, new_figure, publication_style

# Every iteration draws other tasks, so single ones scatter. A window of 1/30 of the run halves the
# scatter of 100 iterations at the price of 3 % of the horizontal resolution.
_WINDOW_SHARE = 1 / 30


class Trained(NamedTuple):
    """The learning curves of one method's seeds."""

    style: MethodStyle
    curves: tuple[LearningCurve, ...]

    @property
    def iteration(self) -> Float[np.ndarray, " iteration"]:
        """The iterations that every seed has finished."""
        return min((curve.iteration for curve in self.curves), key=len)

    @property
    def window(self) -> int:
        """Length of the moving average: odd, so that it has a centre."""
        return 2 * int(len(self.iteration) * _WINDOW_SHARE / 2) + 1


@publication_style()
def plot_learning_curves(trained: Sequence[Trained], reward: str) -> Figure:
    """Draw return and success over meta-iterations, one line per method.

    A line is the moving average of the mean over seeds; its band is the range of the seeds' own
    moving averages, because three seeds are too few for an interval. A single seed has no band, but
    its raw values behind the line. Seeds are drawn as far as all of a method got.
    """
    figure = new_figure(TWO_COLUMNS, 2.05)
    panels = figure.subplots(1, 3)
    panels[1].sharey(panels[0])
    metrics = ("return_before", "return_after", "success_after")
    for axes, metric in zip(panels, metrics, strict=True):
        for line in trained:
            x, style = line.iteration, line.style
            values = np.stack([getattr(curve, metric)[: len(x)] for curve in line.curves])
            if np.isnan(values).all():
                continue
            if len(values) == 1:
                axes.plot(x, values[0], color=style.colour, linewidth=0.5, alpha=0.3)
            smooth = moving_mean(values, line.window)
            curve = np.stack([smooth.mean(0), smooth.min(0), smooth.max(0)])
            draw_curve(axes, x, curve, style, len(values))
        axes.set_title(f"{metric.rpartition('_')[2]} the inner update")
        axes.set_xlabel("meta-iteration")
    panels[0].set_ylabel(f"mean {reward} return")
    percent_axis(panels[2], "success rate")
    explain(figure, panels[1], [_note(trained)])
    return figure


def moving_mean(
    values: Float[np.ndarray, "seed iteration"], window: int
) -> Float[np.ndarray, "seed iteration"]:
    """Return the centred mean over `window` iterations, over fewer at the ends."""
    ones = np.ones(window)
    counts = np.convolve(np.ones(values.shape[1]), ones, mode="same")
    return np.stack([np.convolve(row, ones, mode="same") for row in values]) / counts


def _note(trained: Sequence[Trained]) -> str:
    """Say what lines and bands are."""
    windows = sorted({line.window for line in trained})
    averaged = f"lines: moving average over {' or '.join(map(str, windows))} iterations"
    notes = {
        averaged: windows[-1] > 1,
        "thin: single iterations": any(len(line.curves) == 1 for line in trained),
        "bands: range over the seeds": any(len(line.curves) > 1 for line in trained),
    }
    return "; ".join(note for note, applies in notes.items() if applies)
