"""Learning curves of meta-training."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from maesn.reporting.figures.curves import draw_curve, label_lines, percent_axis
from maesn.reporting.runs import LearningCurve
from maesn.reporting.style import TWO_COLUMNS, Drawn, MethodStyle, new_figure, publication_style

# Every iteration draws other tasks, so single ones scatter. A window of 1/30 of the run halves the
# scatter of 100 iterations at the price of 3 % of the horizontal resolution.
_WINDOW_SHARE = 1 / 30
_METRICS = ("success_after", "return_before", "return_after")


@publication_style()
def plot_learning_curves(
    trained: Mapping[MethodStyle, Sequence[LearningCurve]], reward: str
) -> Drawn:
    """Draw success and return over meta-iterations, one line for all seeds of a method.

    A line is the moving average of the mean over seeds; its band is the range of the seeds' own
    moving averages, because three seeds are too few for an interval. A single seed has no band, but
    its raw values behind the line. Seeds are drawn as far as all of a method got.
    """
    figure = new_figure(TWO_COLUMNS, 2.2)
    panels = figure.subplots(1, 3)
    panels[2].sharey(panels[1])
    windows = set()
    for axes, metric in zip(panels, _METRICS, strict=True):
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
    percent_axis(panels[0], "success rate")
    panels[1].set_ylabel(f"mean {reward} return")
    label_lines(panels[2])
    widths = " or ".join(map(str, sorted(windows)))
    notes = {
        f"lines: moving average over {widths} iterations": max(windows) > 1,
        "thin: single iterations": any(len(curves) == 1 for curves in trained.values()),
        "bands: range over the seeds": any(len(curves) > 1 for curves in trained.values()),
    }
    return Drawn(figure, [note for note, applies in notes.items() if applies])


def moving_mean(
    values: Float[np.ndarray, "seed iteration"], window: int
) -> Float[np.ndarray, "seed iteration"]:
    """Return the centred mean over `window` iterations, over fewer at the ends."""
    ones = np.ones(window)
    counts = np.convolve(np.ones(values.shape[1]), ones, mode="same")
    return np.stack([np.convolve(row, ones, mode="same") for row in values]) / counts
