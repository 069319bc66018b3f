"""The paper's Fig. 6: trajectories from the prior over the goals."""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from maesn.report.adaptation_table import PriorReach
from maesn.report.figures.plane import Limits, draw_goals, draw_paths, plane_axes, shared_limits
from maesn.report.runs import RecordedExploration
from maesn.report.style import BLACK, TWO_COLUMNS, MethodStyle, new_figure, publication_style

_TITLE = 0.42  # inches of every row
_TITLE_CHARACTERS = 32  # across the narrowest panel
_LABELS_BELOW = 0.4  # inches of the last row
_LABELS_BESIDE = 0.5  # inches of a row's width that are not plane


@dataclass(frozen=True)
class ExplorationPanel:
    """What one method explores before adaptation."""

    style: MethodStyle
    exploration: RecordedExploration
    reach: PriorReach | None
    """How many of the goals it reaches; None if that was not counted."""


@publication_style()
def plot_exploration(explorers: Sequence[ExplorationPanel]) -> Figure:
    """Draw trajectories from the prior over the goals, and an untrained policy's beside them.

    The untrained policy is that of the first run.

    Args:
        explorers: one panel each, in one world.
    """
    first = explorers[0].exploration
    paths = [one.exploration.prior_paths for one in explorers]
    limits = shared_limits([first.goals, *paths, first.untrained_paths], first.sparse_radius)
    figure, panels = _panels(len(explorers) + 1, limits)
    for axes, one in zip(panels, explorers, strict=False):
        plane_axes(axes, limits)
        draw_goals(axes, one.exploration.goals, one.exploration.sparse_radius)
        draw_paths(axes, one.exploration.prior_paths, one.style.colour)
        axes.set_title(_title(textwrap.fill(one.style.label, _TITLE_CHARACTERS), one.reach))
    plane_axes(panels[-1], limits)
    draw_goals(panels[-1], first.goals, first.sparse_radius)
    draw_paths(panels[-1], first.untrained_paths, BLACK)
    panels[-1].set_title(_title("untrained policy", first.untrained_reach))
    _label_outer(panels, columns=_num_columns(len(panels)))
    return figure


def _title(name: str, reach: PriorReach | None) -> str:
    if reach is None:
        return name
    return f"{name}\n{reach.share:.0%} of the goals in {reach.episodes} episodes"


def _panels(number: int, limits: Limits) -> tuple[Figure, list[Axes]]:
    """Return a figure with that many panels, high enough for the plane."""
    columns = _num_columns(number)
    rows = math.ceil(number / columns)
    height = (TWO_COLUMNS - _LABELS_BESIDE) / columns * limits.aspect + _TITLE
    figure = new_figure(TWO_COLUMNS, rows * height + _LABELS_BELOW)
    grid = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for unused in grid[number:]:
        unused.remove()
    return figure, grid[:number]


def _num_columns(number: int) -> int:
    return 2 if number in (2, 4) else 3


def _label_outer(panels: Sequence[Axes], columns: int) -> None:
    """Keep the labels of a grid of equal planes at its left and lower edge."""
    for position, axes in enumerate(panels):
        if position % columns:
            axes.set_ylabel("")
            axes.tick_params(labelleft=False)
        if position + columns < len(panels):
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)
