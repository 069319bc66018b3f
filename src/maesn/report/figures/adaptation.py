"""Adaptation curves: over updates, beside the published ones, and of a comparison over steps."""

import csv
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from maesn.report.adaptation_table import AdaptationTable, Line
from maesn.report.comparison import Comparison
from maesn.report.figures.curves import draw_line, explain, note_on_lines, percent_axis
from maesn.report.runs import RecordedRun
from maesn.report.style import DARK_GREY, ONE_COLUMN, TWO_COLUMNS, new_figure, publication_style

_WIDTHS = (1.35, 1.0, 1.0)  # the panel that targets are stated for is the widest
_HEIGHTS = (1.5, 1.0)  # return above, success below
_LINE_CHARACTERS = 58  # of a note in one column
_DOTTED = (0, (1.0, 1.5))
_DASHED = (0, (3.0, 2.0))

# Our presets -> the paper's names. All three MAML presets are compared with the one curve that was
# published; the table's header says what it is.
_PUBLISHED_NAME = {
    "maesn": "MAESN",
    "latent_space": "LatentSpace",
    "maml": "MAML",
    "maml_bias": "MAML",
    "maml_bias_only": "MAML",
    "rl2": "RL2",
    "vime": "VIME",
    "trpo": "TRPO",
    "reinforce": "VPG",
}

# What the published returns depend on, beside the rewards of the reference code: the sparse radius
# in metres (also the family's own, that of a run without one) and the episodes per update.
_PROTOCOLS = {"wheeled": (0.8, 50), "ant": (0.8, 50), "blockpush": (0.2, 20)}


class PublishedCurve(NamedTuple):
    """One published curve; updates that could not be read are absent."""

    name: str
    """The method's name in the paper."""
    update: Float[np.ndarray, " point"]
    mean_return: Float[np.ndarray, " point"]


def comparable_curve(run: RecordedRun, table: AdaptationTable) -> PublishedCurve | None:
    """Return the published curve of a run's method; None if its table means another thing."""
    radius, episodes = _PROTOCOLS.get(run.family, (None, None))
    is_comparable = (
        run.settings["variant"] == "reference"
        and run.settings.get("sparse_radius") in (None, radius)
        and table.reward == "sparse"
        and table.episodes_per_update == episodes
    )
    return published_curve(run.family, run.method) if is_comparable else None


def published_curve(family: str, method: str) -> PublishedCurve | None:
    """Return what the paper shows for a preset; None if it shows nothing."""
    name = _PUBLISHED_NAME.get(method, "")
    text = files("maesn.report").joinpath("published_curves.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    found = [row for row in rows if row["family"] == family and row.get(name)]
    if not found:
        return None
    update, mean_return = np.array([(row["update"], row[name]) for row in found], float).T
    return PublishedCurve(name, update, mean_return)


@publication_style()
def plot_adaptation_curves(
    lines: Sequence[Line], published: Mapping[str, PublishedCurve | None]
) -> Figure:
    """Draw the paper's "Learning progress on novel tasks": return, success and time at the goal.

    All lines are on the same tasks and reward. A published curve, by the name of its line, is thin,
    dashed, of its method's colour, and goes as far as our updates go.
    """
    figure = new_figure(TWO_COLUMNS, 2.35)
    panels = figure.subplots(1, 3, width_ratios=_WIDTHS)
    lengths = {line.label: line.table.episodes_per_update for line in lines}
    measures = ("mean_return", "success_rate", "time_in_region")
    for axes, measure in zip(panels, measures, strict=True):
        labels = {line.label: draw_line(axes, line.table.updates, line, measure) for line in lines}
        axes.set_xlabel("update")
        _episodes_axis(axes, set(lengths.values()))
    panels[0].set_ylabel(f"mean {lines[0].table.reward} return")
    percent_axis(panels[1], "success rate")
    percent_axis(panels[2], "time in goal region")
    _draw_published(panels[0], lines, published)
    notes = note_on_lines(lines, labels)
    known = {label: length for label, length in lengths.items() if length is not None}
    if len(set(known.values())) > 1:
        updates = ", ".join(f"{label} {length}" for label, length in known.items())
        notes.append(f"episodes per update: {updates}")
    explain(figure, panels[0], notes)
    return figure


@publication_style()
def plot_comparison(comparison: Comparison) -> Figure:
    """Draw return and success over the steps that were learned from in the new task.

    Baseline and oracle are horizontal lines. The curve of a policy with recurrent state is faint
    beyond the length of the trials that it was trained on. The legend says where a method was
    adapted to the first tasks alone.
    """
    lines = comparison.lines
    most_tasks = max(line.num_tasks for line in lines)
    figure = new_figure(ONE_COLUMN, 3.4)
    panels = figure.subplots(2, 1, sharex=True, height_ratios=_HEIGHTS)
    labels = {}
    for axes, measure in zip(panels, ("mean_return", "success_rate"), strict=True):
        for line in lines:
            first = "first task" if line.num_tasks == 1 else f"first {line.num_tasks} tasks"
            fewer = "" if line.num_tasks == most_tasks else f" ({first})"
            labels[line.label] = draw_line(axes, comparison.steps(line), line, measure, fewer)
    bounds = comparison.bounds(most_tasks)
    for height, name, style in zip(bounds, ("baseline", "oracle"), (_DOTTED, "-"), strict=True):
        if height is not None:
            panels[0].axhline(height, color=DARK_GREY, linewidth=0.8, linestyle=style, label=name)
    panels[0].set_ylabel(f"mean {lines[0].table.reward} return")
    percent_axis(panels[1], "success rate")
    _steps_axis(panels[1], comparison)
    explain(figure, panels[0], note_on_lines(lines, labels), _LINE_CHARACTERS)
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
        (drawn_line,) = axes.plot(curve.update[shown], curve.mean_return[shown])
        drawn_line.set(color=line.style.colour, linestyle=_DASHED, linewidth=0.7)
        drawn_line.set_label(f"{curve.name}, published")


def _episodes_axis(axes: Axes, lengths: set[int | None]) -> None:
    """Count episodes along the top, where every update of every line has the same number."""
    length, *others = lengths
    if others or length is None:
        return
    scale = float(length)
    functions = (lambda update: np.multiply(update, scale), lambda count: np.divide(count, scale))
    top = axes.secondary_xaxis("top", functions=functions)
    top.set_xlabel("episodes learned from")
    top.spines["top"].set_visible(True)


def _steps_axis(axes: Axes, comparison: Comparison) -> None:
    """Count steps; beyond the shortest update logarithmically, if the updates differ in length."""
    counts = [comparison.steps(line) for line in comparison.lines]
    shortest = {int(steps[1]) for steps in counts if len(steps) > 1}
    axes.set_xlabel("environment steps in the new task")
    if len(shortest) > 1:
        axes.set_xscale("symlog", linthresh=min(shortest), linscale=0.5)
        axes.set_xlim(left=0)
    else:
        axes.ticklabel_format(axis="x", style="sci", scilimits=(-3, 4))
