"""The paper's Fig. 4, right: where the goals of a family lie."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from maesn.report.figures.plane import draw_start, plane_axes, shared_limits
from maesn.report.runs import RecordedExploration
from maesn.report.style import (
    BLUE,
    BLUISH_GREEN,
    ONE_COLUMN,
    VERMILLION,
    new_figure,
    publication_style,
)

_SURROUNDINGS = 0.85  # inches of labels and legend above and below the plane
_BESIDE = 0.6  # inches of labels beside it


@publication_style()
def plot_task_distribution(exploration: RecordedExploration) -> Figure:
    """Draw the goals of training, those adapted to, and the size of one goal region."""
    training, goals = exploration.training_goals, exploration.goals
    radius = exploration.sparse_radius
    middle = goals[np.argmin(np.linalg.norm(goals - goals.mean(0), axis=-1))]
    limits = shared_limits([middle[None], goals, training, exploration.prior_paths[:, 0]], radius)
    figure = new_figure(ONE_COLUMN, (ONE_COLUMN - _BESIDE) * limits.aspect + _SURROUNDINGS)
    axes = figure.subplots()
    axes.plot(
        *training.T,
        "o",
        color=VERMILLION,
        markersize=3.5,
        markeredgewidth=0,
        alpha=0.7,
        label=f"{len(training)} training goals",
    )
    axes.plot(
        *goals.T,
        "x",
        color=BLUE,
        markersize=3.5,
        markeredgewidth=0.9,
        label=f"{len(goals)} goals adapted to",
    )
    axes.add_patch(
        Circle(
            (float(middle[0]), float(middle[1])),
            radius,
            facecolor=BLUISH_GREEN,
            alpha=0.2,
            linewidth=0,
            zorder=0.5,
            label=f"goal region ({radius:g} m)",
        )
    )
    draw_start(axes, exploration.prior_paths)
    plane_axes(axes, limits)
    figure.legend(loc="outside lower center", ncols=2, columnspacing=1.2)
    return figure
