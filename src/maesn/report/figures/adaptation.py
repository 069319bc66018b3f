"""Adaptation curves on new tasks: the paper's "Learning progress on novel tasks"."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from maesn.report.figures.curves import draw_line, explain, note_on_lines, percent_axis
from maesn.report.line import Line
from maesn.report.published import PublishedCurve
from maesn.report.style import TWO_COLUMNS, new_figure, publication_style

_HEIGHT = 2.35  # inches, without the legend
_WIDTHS = (1.35, 1.0, 1.0)  # the panel that targets are stated for is the widest

_MEASURES = ("mean_return", "success_rate", "time_in_region")


@publication_style()
def plot_adaptation_curves(
    lines: Sequence[Line], published: Mapping[str, PublishedCurve | None]
) -> Figure:
    """Draw return, success and time at the goal over updates, with intervals.

    A published curve is a thin dashed line of its method's colour, as far as our updates go.

    Args:
        lines: what to draw, all on the same tasks and reward.
        published: what the paper shows for lines, by their names.
    """
    figure = new_figure(TWO_COLUMNS, _HEIGHT)
    panels = figure.subplots(1, 3, width_ratios=_WIDTHS)
    for axes, measure in zip(panels, _MEASURES, strict=True):
        labels = {
            line.label: draw_line(axes, line.tables[0].updates, line, measure) for line in lines
        }
        axes.set_xlabel("update")
        _episodes_axis(axes, lines)
    panels[0].set_ylabel(f"mean {lines[0].tables[0].reward} return")
    percent_axis(panels[1], "success rate")
    percent_axis(panels[2], "time in goal region")
    _draw_published(panels[0], lines, published)
    explain(figure, panels[0], [*note_on_lines(lines, labels), *_note_on_updates(lines)])
    return figure


def _draw_published(
    axes: Axes, lines: Sequence[Line], published: Mapping[str, PublishedCurve | None]
) -> None:
    drawn: set[str] = set()
    for line in lines:
        curve = published.get(line.name)
        if curve is None or curve.name in drawn:
            continue
        drawn.add(curve.name)
        shown = curve.update <= max(table.updates[-1] for table in line.tables)
        axes.plot(
            curve.update[shown],
            curve.mean_return[shown],
            color=line.style.colour,
            linestyle=(0, (3, 2)),
            linewidth=0.7,
            label=f"{curve.name}, published",
        )


def _episodes_axis(axes: Axes, lines: Sequence[Line]) -> None:
    """Count episodes along the top, where every update of every line has the same number."""
    counts = {table.episodes_per_update for line in lines for table in line.tables}
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


def _note_on_updates(lines: Sequence[Line]) -> list[str]:
    """Say how long an update is, where lines differ in it."""
    counts = {line.label: line.tables[0].episodes_per_update for line in lines}
    known = {label: count for label, count in counts.items() if count is not None}
    if len(set(known.values())) < 2:
        return []
    return [f"episodes per update: {', '.join(f'{one} {count}' for one, count in known.items())}"]
