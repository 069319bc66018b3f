"""Exploration before adaptation, and adapted latents: the paper's Fig. 4 (right), 6 to 8.

Positions in the plane of the world are in metres.
"""

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import ListedColormap, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.ticker import MultipleLocator
from matplotlib.transforms import Bbox

from maesn.reporting import style
from maesn.reporting.reading import prior_reach
from maesn.reporting.runs import Latents, Positions, RecordedExploration

Points = Float[np.ndarray, "point 2"]
Colours = str | Float[np.ndarray, "point 4"]

_TITLE_CHARACTERS = 32  # across the narrowest panel
_PRIOR_LINE: dict[str, Any] = {"color": style.BLACK, "linestyle": "--", "linewidth": 1.0}
# Overlapping discs stay translucent: this is the sum of their opacities, within limits for one.
_DISC_INK, _DISC_OPACITY = 2.0, (0.015, 0.2)
# Lightness rises evenly, in colour and in grey; without the end that is invisible on white.
_DIRECTION_COLOURS = ListedColormap(colormaps["viridis"](np.linspace(0.0, 0.93, 256)))
_ANGLE_STEP = 30.0  # degrees; the scale's ends and ticks are multiples


@style.publication_style()
def plot_task_distribution(exploration: RecordedExploration) -> Figure:
    """Draw the goals of training, those adapted to, and the size of one goal region.

    Objects that a task lays out beside its goal, such as blocks, are drawn as well.
    """
    training, goals = exploration.training_goals, exploration.goals
    marks = [
        (f"{len(training)} training goals", training, "o", style.VERMILLION),
        (f"{len(goals)} goals adapted to", goals, "x", style.BLUE),
        ("objects of training tasks", exploration.training_landmarks, "s", style.VERMILLION),
        ("objects of tasks adapted to", exploration.landmarks, "s", style.BLUE),
        ("start", exploration.prior_paths[:, 0].mean(0), "+", style.BLACK),
    ]
    # Once each: several tasks may share a layout.
    drawn = [
        (np.unique(positions.reshape(-1, 2), axis=0).T, marker, colour, label)
        for label, positions, marker, colour in marks
        if positions is not None
    ]
    middle = goals[np.argmin(np.linalg.norm(goals - goals.mean(0), axis=-1))]
    radius = exploration.sparse_radius
    limits = shared_limits([middle, *(points.T for points, *_ in drawn)], radius)
    # Beside the plane labels take 0.6 inches, above and below it labels and legend take 0.85.
    height = (style.ONE_COLUMN - 0.6) / limits.width * limits.height + 0.85
    figure = style.new_figure(style.ONE_COLUMN, height)
    axes = figure.subplots()
    for (x, y), marker, colour, label in drawn:
        axes.plot(x, y, marker, color=colour, label=label, markersize=3.5, fillstyle="none")
    region = Circle(tuple(middle.tolist()), radius, label=f"goal region ({radius:g} m)")
    region.set(facecolor=style.BLUISH_GREEN, alpha=0.2, linewidth=0, zorder=0.5)
    axes.add_patch(region)
    _set_plane(axes, limits)
    figure.legend(loc="outside lower center", ncols=2, columnspacing=1.2)
    return figure


@style.publication_style()
def plot_exploration(
    explored: Sequence[tuple[style.MethodStyle, RecordedExploration, str]],
) -> Figure:
    """Draw trajectories from the prior over the goals, and an untrained policy's beside them.

    Each method comes with its record and the share of goals that it reaches, in words; empty if
    that was not counted. The untrained policy is that of the first run. All are in one world.
    """
    first = explored[0][1]
    solved, episodes = first.solved_at_reset > 0, first.episodes_per_task
    reach = prior_reach(first.untrained_success_rate, solved, episodes)
    untrained = style.MethodStyle("untrained policy", style.BLACK)
    drawn = [
        (f"{textwrap.fill(look.label, _TITLE_CHARACTERS)}\n{said}".rstrip(), paths, look.colour)
        for look, paths, said in (
            *((look, record.prior_paths, said) for look, record, said in explored),
            (untrained, first.untrained_paths, reach),
        )
    ]
    return _draw_explored(first, drawn)


@style.publication_style()
def plot_structured_noise(exploration: RecordedExploration) -> Figure:
    """Draw trajectories with the latent drawn from the prior beside those with it fixed.

    Colours are the direction in which an episode ends.
    """
    assert exploration.fixed_paths is not None  # methods without latents have no such figure
    scale = direction_scale(exploration.goals)
    shown = {
        "z sampled from the prior": exploration.prior_paths,
        "z fixed": exploration.fixed_paths,
    }
    drawn = []
    for title, paths in shown.items():
        # Root mean square distance from their mean.
        spread = float(np.sqrt(paths[:, -1].var(0).sum()))
        colours = scale.to_rgba(directions(paths[:, -1]))
        drawn.append((f"{title}\nfinal positions spread {spread:.2f} m", paths, colours))
    figure = _draw_explored(exploration, drawn)
    _direction_bar(figure, scale, "final direction (°)")
    return figure


def _draw_explored(
    world: RecordedExploration, drawn: Sequence[tuple[str, Positions, Colours]]
) -> Figure:
    """Draw a panel for each title, paths and colours of the paths, all with the world's goals.

    Goals lie in translucent regions; a path is a line with a dot at its end.
    """
    goals = world.goals
    limits = shared_limits([goals, *(paths for _, paths, _ in drawn)], world.sparse_radius)
    columns = 2 if len(drawn) in (2, 4) else 3
    rows = math.ceil(len(drawn) / columns)
    # Labels take 0.5 inches of a row and 0.4 below the last one, the title 0.42 of each.
    height = (style.TWO_COLUMNS - 0.5) / columns / limits.width * limits.height + 0.42
    figure = style.new_figure(style.TWO_COLUMNS, rows * height + 0.4)
    opacity = float(np.clip(_DISC_INK / len(goals), *_DISC_OPACITY))
    region = {"facecolor": style.GREY, "edgecolor": "none", "alpha": opacity, "zorder": 0.5}
    for position, (title, paths, colours) in enumerate(drawn, start=1):
        axes = figure.add_subplot(rows, columns, position, title=title)
        _draw_ellipses(axes, goals, np.full_like(goals, world.sparse_radius), **region)
        _draw_dots(axes, goals, style.DARK_GREY)
        axes.add_collection(LineCollection(list(paths), colors=colours, linewidths=0.7, alpha=0.6))
        _draw_dots(axes, paths[:, -1], colours)
        _set_plane(axes, limits)
        axes.label_outer()
    return figure


@style.publication_style()
def plot_latents(latents: Latents, goals: Points | None = None) -> Figure:
    """Draw every task's latent distribution as its 1-sigma ellipse, before and after adaptation.

    The prior N(0, I) is a dashed circle of radius 1. Of more than two components, those whose means
    spread most after adaptation are drawn. The direction of a task's goal, where it is known, is
    the colour of its ellipse.
    """
    chosen = np.sort(np.argsort(-latents.mean[:, -1].var(0), kind="stable")[:2])
    mean, log_std = (x[:, [0, -1]][..., chosen] for x in (latents.mean, latents.log_std))
    std = np.exp(log_std)
    limits = shared_limits([np.array([[-1.0, -1.0], [1.0, 1.0]]), mean - std, mean + std])
    # A plane is 2.5 inches wide; title, labels and legend take 0.95.
    height = 2.5 / limits.width * limits.height + 0.95
    figure = style.new_figure(style.TWO_COLUMNS, height)
    panels = figure.subplots(1, 2, sharex=True, sharey=True).tolist()
    colours = np.tile(to_rgba(style.BLUE), (len(mean), 1))
    if goals is not None:
        scale = direction_scale(goals)
        colours = scale.to_rgba(directions(goals))
        _direction_bar(figure, scale, "direction of the goal (°)")
    for column, axes in enumerate(panels):
        outline = {"facecolors": "none", "edgecolors": colours, "linewidths": 0.7, "alpha": 0.8}
        _draw_ellipses(axes, mean[:, column], std[:, column], **outline)
        _draw_dots(axes, mean[:, column], colours)
        axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, zorder=3, **_PRIOR_LINE))
        _set_plane(axes, limits, *(f"latent component {number + 1}" for number in chosen))
        axes.label_outer()
        last = latents.mean.shape[1] - 1
        axes.set_title(f"after update {last}" if column else "before adaptation")
    legend = {
        "prior N(0, I), 1σ": Line2D([], [], **_PRIOR_LINE),
        "a task's latent distribution, 1σ": Line2D([], [], color=style.GREY, linewidth=0.7),
    }
    figure.legend(legend.values(), legend.keys(), loc="outside lower center", ncols=2)
    return figure


def shared_limits(points: Sequence[Float[np.ndarray, "... 2"]], radius: float = 0.0) -> Bbox:
    """Return a box with a margin that holds all points, and discs around the first ones."""
    flat = [array.reshape(-1, 2) for array in points]
    corners = np.concatenate([flat[0] - radius, flat[0] + radius, *flat[1:]])
    box = Bbox([corners.min(0), corners.max(0)])
    return box.padded(max(0.05 * max(box.width, box.height), 1e-3))


def _set_plane(axes: Axes, limits: Bbox, xlabel: str = "x (m)", ylabel: str = "y (m)") -> None:
    """Give a panel limits, and the same scale in both directions."""
    axes.set(xlim=limits.intervalx, ylim=limits.intervaly, xlabel=xlabel, ylabel=ylabel)
    axes.set_aspect("equal")
    axes.grid(visible=False)


def _draw_dots(axes: Axes, points: Points, colours: Colours) -> None:
    x, y = points.T
    axes.scatter(x, y, c=colours, s=4.0, zorder=2.5)


def _draw_ellipses(axes: Axes, centres: Points, half_axes: Points, **look: Any) -> None:
    widths, heights = 2 * half_axes.T
    look |= {"units": "xy", "offsets": centres, "offset_transform": axes.transData}
    axes.add_collection(EllipseCollection(widths, heights, np.zeros(len(centres)), **look))


def directions(points: Points) -> Float[np.ndarray, " point"]:
    """Return the angle of each point seen from the origin, in degrees from the x axis."""
    return np.degrees(np.arctan2(points[:, 1], points[:, 0]))


def direction_scale(goals: Points) -> ScalarMappable:
    """Return a colour for each direction: one end of the goals' range to the other."""
    angles = directions(goals) / _ANGLE_STEP
    low, high = float(np.floor(angles.min())), float(np.ceil(angles.max()))
    norm = Normalize(_ANGLE_STEP * low, _ANGLE_STEP * max(high, low + 1))
    return ScalarMappable(norm, _DIRECTION_COLOURS)


def _direction_bar(figure: Figure, scale: ScalarMappable, label: str) -> None:
    ticks = MultipleLocator(_ANGLE_STEP)
    figure.colorbar(scale, ax=figure.axes, label=label, ticks=ticks, shrink=0.85, aspect=25)
