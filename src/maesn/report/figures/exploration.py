"""What is explored before adaptation: the tasks, the prior's episodes, the share of the latent.

The paper's Fig. 4 (right), 6 and 8.
"""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from maesn.report.adaptation_table import PriorReach
from maesn.report.figures.plane import (
    Limits,
    direction_bar,
    direction_scale,
    directions,
    draw_goals,
    draw_paths,
    draw_prior,
    equal_axes,
    final_positions,
    plane_axes,
    shared_limits,
)
from maesn.report.runs import RecordedExploration
from maesn.report.style import (
    BLACK,
    BLUE,
    BLUISH_GREEN,
    ONE_COLUMN,
    TWO_COLUMNS,
    VERMILLION,
    MethodStyle,
    new_figure,
    publication_style,
)

_TITLE_CHARACTERS = 32  # across the narrowest panel


@dataclass(frozen=True)
class ExplorationPanel:
    """What one method explores before adaptation."""

    style: MethodStyle
    exploration: RecordedExploration
    reach: PriorReach | None
    """How many of the goals it reaches; None if that was not counted."""


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
    # Beside the plane labels take 0.6 inches, above and below it labels and legend take 0.85.
    figure = new_figure(ONE_COLUMN, (ONE_COLUMN - 0.6) * limits.aspect + 0.85)
    axes = figure.subplots()
    _mark(axes, training, "o", VERMILLION, f"{len(training)} training goals", alpha=0.7)
    _mark(axes, goals, "x", BLUE, f"{len(goals)} goals adapted to", markeredgewidth=0.9)
    region = Circle((float(middle[0]), float(middle[1])), radius, facecolor=BLUISH_GREEN)
    region.set(alpha=0.2, linewidth=0, zorder=0.5, label=f"goal region ({radius:g} m)")
    axes.add_patch(region)
    for tasks, (array, colour) in landmarks.items():
        if array is not None:
            # Once each: several tasks may share a layout.
            objects, label = np.unique(array.reshape(-1, 2), axis=0), f"objects of {tasks}"
            _mark(axes, objects, "s", colour, label, markeredgewidth=0.7, fillstyle="none")
    start = starts.mean(0, keepdims=True)
    _mark(axes, start, "+", BLACK, "start", markersize=6, markeredgewidth=1.0, zorder=3)
    plane_axes(axes, limits)
    figure.legend(loc="outside lower center", ncols=2, columnspacing=1.2)
    return figure


def _mark(
    axes: Axes,
    points: Float[np.ndarray, "point 2"],
    marker: str,
    colour: str,
    label: str,
    **style: Any,
) -> None:
    usual: dict[str, Any] = {"markersize": 3.5, "markeredgewidth": 0}
    axes.plot(*points.T, marker, color=colour, label=label, **{**usual, **style})


@publication_style()
def plot_exploration(explorers: Sequence[ExplorationPanel]) -> Figure:
    """Draw trajectories from the prior over the goals, and an untrained policy's beside them.

    The untrained policy is that of the first run. All are in one world.
    """
    first = explorers[0].exploration
    paths = [one.exploration.prior_paths for one in explorers]
    limits = shared_limits([first.goals, *paths, first.untrained_paths], first.sparse_radius)
    number = len(explorers) + 1
    columns = 2 if number in (2, 4) else 3
    rows = math.ceil(number / columns)
    # Labels take 0.5 inches of a row and 0.4 below the last one, the title 0.42 of each.
    height = (TWO_COLUMNS - 0.5) / columns * limits.aspect + 0.42
    figure = new_figure(TWO_COLUMNS, rows * height + 0.4)
    panels = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for unused in panels[number:]:
        unused.remove()
    for axes, one in zip(panels, explorers, strict=False):
        _draw_explored(axes, limits, one.exploration, one.exploration.prior_paths, one.style.colour)
        axes.set_title(_title(textwrap.fill(one.style.label, _TITLE_CHARACTERS), one.reach))
    untrained = panels[number - 1]
    _draw_explored(untrained, limits, first, first.untrained_paths, BLACK)
    untrained.set_title(_title("untrained policy", first.untrained_reach))
    for position, axes in enumerate(panels[:number]):
        if position % columns:
            _drop_y_label(axes)
        if position + columns < number:
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)
    return figure


def _title(name: str, reach: PriorReach | None) -> str:
    if reach is None:
        return name
    return f"{name}\n{reach.share:.0%} of the goals in {reach.episodes} episodes"


@publication_style()
def plot_structured_noise(exploration: RecordedExploration) -> Figure:
    """Draw trajectories with the latent drawn from the prior beside those with it fixed.

    Colours are the direction in which an episode ends. If the drawn latents are known and have two
    components at least, a panel before them shows which latent went where.
    """
    sampled, fixed = exploration.prior_paths, exploration.fixed_paths
    assert fixed is not None  # methods without latents have no such figure
    limits = shared_limits([exploration.goals, sampled, fixed], exploration.sparse_radius)
    scale = direction_scale(exploration.goals)
    ends = {"z sampled from the prior": sampled, "z fixed": fixed}
    latents = exploration.prior_latents
    has_latents = latents is not None and latents.shape[1] >= 2
    # The panel of latents is as high as the planes beside it.
    widths = [*([limits.aspect] if has_latents else []), 1.0, 1.0]
    # Beside the panels labels and colour bar take 1.7 inches, above and below them text takes 0.8.
    height = (TWO_COLUMNS - 1.7) / sum(widths) * limits.aspect + 0.8
    figure = new_figure(TWO_COLUMNS, height)
    panels = figure.subplots(1, len(widths), width_ratios=widths).tolist()
    for axes, (title, paths) in zip(panels[-2:], ends.items(), strict=True):
        final = final_positions(paths)
        colours = np.asarray(scale.to_rgba(directions(final)))
        _draw_explored(axes, limits, exploration, paths, colours)
        # Root mean square distance from their mean.
        spread = float(np.sqrt(final.var(0).sum()))
        axes.set_title(f"{title}\nfinal positions spread {spread:.2f} m")
    if latents is not None and has_latents:
        colours = np.asarray(scale.to_rgba(directions(final_positions(sampled))))
        _draw_latents(panels[0], latents[:, :2], colours)
    _drop_y_label(panels[-1])
    direction_bar(figure, panels, scale, "final direction (°)")
    return figure


def _draw_latents(
    axes: Axes,
    latents: Float[np.ndarray, "episode 2"],
    colours: Float[np.ndarray, "episode 4"],
) -> None:
    axes.scatter(latents[:, 0], latents[:, 1], c=colours, s=7, linewidths=0, zorder=2.5)
    draw_prior(axes)
    reach = np.full(2, 1.15 * float(np.abs(latents).max()))
    equal_axes(axes, Limits(-reach, reach))
    axes.set(xlabel="latent component 1", ylabel="latent component 2", title="the sampled z\n")


def _draw_explored(
    axes: Axes,
    limits: Limits,
    exploration: RecordedExploration,
    paths: Float[np.ndarray, "episode time_plus_1 2"],
    colours: str | Float[np.ndarray, "episode 4"],
) -> None:
    """Draw paths over the goals of a world."""
    plane_axes(axes, limits)
    draw_goals(axes, exploration.goals, exploration.sparse_radius)
    draw_paths(axes, paths, colours)


def _drop_y_label(axes: Axes) -> None:
    axes.set_ylabel("")
    axes.tick_params(labelleft=False)
