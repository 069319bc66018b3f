"""Learning curves of meta-training."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from maesn.reporting import style
from maesn.reporting.figures.curves import draw_curve, label_lines, percent_axis
from maesn.reporting.runs import LearningCurve

# Every iteration draws other tasks, so single ones scatter. A window of 1/30 of the run halves the
# scatter of 100 iterations at the price of 3 % of the horizontal resolution.
_WINDOW_SHARE = 1 / 30


@style.publication_style()
def plot_learning_curves(
    trained: Mapping[style.MethodStyle, Sequence[LearningCurve]], reward: str
) -> style.Drawn:
    """Draw success and return over meta-iterations, one line for all seeds of a method.

    A line is the moving average of the mean over seeds; its band is the range of the seeds' own
    moving averages, because three seeds are too few for an interval. A single seed has no band, but
    its raw values behind the line. Seeds are drawn as far as all of a method got.
    """
    figure = style.new_figure(style.TWO_COLUMNS, 2.2)
    panels = figure.subplots(1, 3)
    panels[2].sharey(panels[1])
    metrics, windows = ("success_after", "return_before", "return_after"), set()
    for axes, metric in zip(panels, metrics, strict=True):
        for look, curves in trained.items():
            x = min((curve.iteration for curve in curves), key=len)
            windows.add(window_of(len(x)))
            values = np.stack([getattr(curve, metric)[: len(x)] for curve in curves])
            if np.isnan(values).all():
                continue
            if len(values) == 1:
                axes.plot(x, values[0], color=look.colour, linewidth=0.5, alpha=0.3)
            smooth = moving_mean(values, window_of(len(x)))
            draw_curve(axes, x, (smooth.mean(0), smooth.min(0), smooth.max(0)), look, len(values))
        axes.set_title(f"{metric.rpartition('_')[2]} the inner update")
        axes.set_xlabel("meta-iteration")
    percent_axis(panels[0], "success rate")
    panels[1].set_ylabel(f"mean {reward} return")
    label_lines(panels[2])
    numbers = {len(curves) for curves in trained.values()}
    widths = " or ".join(map(str, sorted(windows)))
    notes = {
        f"lines: moving average over {widths} iterations": max(windows) > 1,
        "thin: single iterations": min(numbers) == 1,
        "bands: range over the seeds": max(numbers) > 1,
    }
    return style.Drawn(figure, [note for note, applies in notes.items() if applies])


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
