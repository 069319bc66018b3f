"""The paper's Fig. 4, right: where the goals of a family lie, and what else tasks lay out."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
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
    """Draw the goals of training, those adapted to, and the size of one goal region.

    What a task lays out beside its goal, such as blocks, is drawn as well.
    """
    training, goals = exploration.training_goals, exploration.goals
    radius = exploration.sparse_radius
    middle = goals[np.argmin(np.linalg.norm(goals - goals.mean(0), axis=-1))]
    landmarks = {
        "training tasks": (exploration.training_landmarks, VERMILLION),
        "tasks adapted to": (exploration.landmarks, BLUE),
    }
    positions = [array for array, _ in landmarks.values() if array is not None]
    starts = exploration.prior_paths[:, 0]
    limits = shared_limits([middle[None], goals, training, starts, *positions], radius)
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
    for tasks, (array, colour) in landmarks.items():
        if array is not None:
            _draw_landmarks(axes, array, f"objects of {tasks}", colour)
    draw_start(axes, exploration.prior_paths)
    plane_axes(axes, limits)
    figure.legend(loc="outside lower center", ncols=2, columnspacing=1.2)
    return figure


def _draw_landmarks(
    axes: Axes, landmarks: Float[np.ndarray, "task landmark 2"], label: str, colour: str
) -> None:
    """Draw each object once: several tasks may share a layout."""
    positions = np.unique(landmarks.reshape(-1, 2), axis=0)
    axes.plot(
        *positions.T,
        "s",
        color=colour,
        fillstyle="none",
        markersize=3.5,
        markeredgewidth=0.7,
        label=label,
    )
