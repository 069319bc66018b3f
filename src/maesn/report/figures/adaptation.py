"""Adaptation curves on new tasks: the paper's "Learning progress on novel tasks"."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from maesn.report.adaptation_table import AdaptationTable, stack_seeds
from maesn.report.figures.curves import (
    draw_intervals,
    explain,
    note_on_bands,
    note_on_trials,
    percent_axis,
)
from maesn.report.published import PublishedCurve
from maesn.report.series import Series
from maesn.report.statistics import mean_intervals
from maesn.report.style import TWO_COLUMNS, new_figure, publication_style

_HEIGHT = 2.35  # inches, without the legend
_WIDTHS = (1.35, 1.0, 1.0)  # the panel that targets are stated for is the widest

_MEASURES = ("mean_return", "success_rate", "time_in_region")


@dataclass(frozen=True)
class AdaptedSeries:
    """A series, the adaptation tables of its seeds, and what the paper shows for its method."""

    series: Series
    tables: tuple[AdaptationTable, ...]
    published: PublishedCurve | None = None


@publication_style()
def plot_adaptation_curves(adapted: Sequence[AdaptedSeries]) -> Figure:
    """Draw return, success and time at the goal over updates, with intervals.

    The published curve of a method is a thin dashed line of its colour, as far as our updates go.

    Args:
        adapted: what to draw, all on the same tasks and reward.
    """
    figure = new_figure(TWO_COLUMNS, _HEIGHT)
    panels = figure.subplots(1, 3, width_ratios=_WIDTHS)
    for axes, measure in zip(panels, _MEASURES, strict=True):
        labels = {line.series.label: _draw_series(axes, line, measure) for line in adapted}
        axes.set_xlabel("update")
        _episodes_axis(axes, adapted)
    panels[0].set_ylabel(f"mean {adapted[0].tables[0].reward} return")
    percent_axis(panels[1], "success rate")
    percent_axis(panels[2], "time in goal region")
    _draw_published(panels[0], adapted)
    explain(figure, panels[0], _note(adapted, labels))
    return figure


def _draw_series(axes: Axes, line: AdaptedSeries, measure: str) -> str:
    """Draw one line and return what its band resamples."""
    intervals, table = mean_intervals(stack_seeds(line.tables, measure)), line.tables[0]
    updates, seeds = table.updates.astype(float), len(line.tables)
    return draw_intervals(axes, updates, intervals, line.series.style, seeds, table.first_beyond)


def _draw_published(axes: Axes, adapted: Sequence[AdaptedSeries]) -> None:
    drawn: set[str] = set()
    for line in adapted:
        curve = line.published
        if curve is None or curve.name in drawn:
            continue
        drawn.add(curve.name)
        last = max(int(table.updates[-1]) for table in line.tables)
        shown = curve.update <= last
        axes.plot(
            curve.update[shown],
            curve.mean_return[shown],
            color=line.series.style.colour,
            linestyle=(0, (3, 2)),
            linewidth=0.7,
            label=f"{curve.name}, published",
        )


def _episodes_axis(axes: Axes, adapted: Sequence[AdaptedSeries]) -> None:
    """Count episodes along the top, where every update of every line has the same number."""
    counts = {table.episodes_per_update for line in adapted for table in line.tables}
    per_update = counts.pop()
    if counts or per_update is None:
        return
    scale = float(per_update)
    top = axes.secondary_xaxis(
        "top",
        functions=(
            lambda update: np.multiply(update, scale),
            lambda count: np.divide(count, scale),
        ),
    )
    top.set_xlabel("episodes learned from")
    top.spines["top"].set_visible(True)


def _note(adapted: Sequence[AdaptedSeries], labels: dict[str, str]) -> str:
    """Say what the bands are, what is faint, and how long an update is where that differs."""
    parts = note_on_bands(labels)
    counts = {line.series.label: line.tables[0].episodes_per_update for line in adapted}
    known = {label: count for label, count in counts.items() if count is not None}
    if len(set(known.values())) > 1:
        said = (f"{label} {count}" for label, count in known.items())
        parts.append(f"episodes per update: {', '.join(said)}")
    for line in adapted:
        table = line.tables[0]
        parts += note_on_trials(line.series.label, table.trial_episodes, table.first_beyond)
    return "\n".join(parts)
