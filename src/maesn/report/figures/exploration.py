"""The paper's Fig. 6: trajectories from the prior over the goals."""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from maesn.report.adaptation_table import AdaptationTable, PriorReach
from maesn.report.figures.plane import (
    Limits,
    draw_goals,
    draw_paths,
    plane_axes,
    shared_limits,
)
from maesn.report.runs import RecordedExploration
from maesn.report.series import Series
from maesn.report.style import BLACK, TWO_COLUMNS, new_figure, publication_style

_TITLE = 0.42  # inches of every row
_TITLE_CHARACTERS = 32  # across the narrowest panel
_LABELS_BELOW = 0.4  # inches of the last row
_LABELS_BESIDE = 0.5  # inches of a row's width that are not plane


@dataclass(frozen=True)
class ExploringSeries:
    """A series, and what the first of its runs explores."""

    series: Series
    exploration: RecordedExploration
    table: AdaptationTable | None
    """Adaptation to the goals with sparse reward, which counts how many the prior reaches."""

    @property
    def title(self) -> str:
        """Title of the panel."""
        reach = None if self.table is None else self.table.prior_reach
        name = textwrap.fill(self.series.label, _TITLE_CHARACTERS)
        return name if reach is None else f"{name}\n{_share(reach)}"


@publication_style()
def plot_exploration(exploring: Sequence[ExploringSeries]) -> Figure:
    """Draw trajectories from the prior over the goals, and an untrained policy's beside them.

    The untrained policy is that of the first series.

    Args:
        exploring: one panel each, in one world.
    """
    first = exploring[0].exploration
    paths = [panel.exploration.prior_paths for panel in exploring]
    limits = shared_limits([first.goals, *paths, first.untrained_paths], first.sparse_radius)
    figure, panels = _panels(len(exploring) + 1, limits)
    for axes in panels:
        plane_axes(axes, limits)
    for axes, panel in zip(panels, exploring, strict=False):
        draw_goals(axes, panel.exploration.goals, panel.exploration.sparse_radius)
        draw_paths(axes, panel.exploration.prior_paths, panel.series.style.colour)
        axes.set_title(panel.title)
    draw_goals(panels[-1], first.goals, first.sparse_radius)
    draw_paths(panels[-1], first.untrained_paths, BLACK)
    untrained = first.untrained_reach
    panels[-1].set_title("untrained policy" + (f"\n{_share(untrained)}" if untrained else ""))
    _label_outer(panels, columns=_num_columns(len(panels)))
    return figure


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


def _share(reach: PriorReach) -> str:
    return f"{reach.share:.0%} of the goals in {reach.episodes} episodes"
