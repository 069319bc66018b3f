"""Drawing in the plane of the world, in metres: paths, goals, limits that panels share."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MultipleLocator
from matplotlib.transforms import Bbox

from maesn.reporting.runs import Positions, RecordedExploration
from maesn.reporting.style import BLACK, DARK_GREY, GREY

# Lightness rises evenly, in colour and in grey; without the end that is invisible on white.
_DIRECTION_COLOURS = ListedColormap(colormaps["viridis"](np.linspace(0.0, 0.93, 256)))
_ANGLE_STEP = 30.0  # degrees; the scale's ends and ticks are multiples

Points = Float[np.ndarray, "point 2"]
Colours = str | Float[np.ndarray, "point 4"]
PRIOR_LINE: dict[str, Any] = {"color": BLACK, "linestyle": "--", "linewidth": 1.0}

_MARGIN = 0.05  # of the larger side
# Overlapping discs stay translucent: this is the sum of their opacities, within limits for one.
_DISC_INK = 2.0
_DISC_OPACITY = (0.015, 0.2)


def shared_limits(points: Sequence[Float[np.ndarray, "... 2"]], radius: float = 0.0) -> Bbox:
    """Return a box that holds all points, with discs of `radius` around the first ones."""
    flat = [array.reshape(-1, 2) for array in points]
    corners = np.concatenate([flat[0] - radius, flat[0] + radius, *flat[1:]])
    box = Bbox([corners.min(0), corners.max(0)])
    return box.padded(max(_MARGIN * max(box.width, box.height), 1e-3))


def equal_axes(axes: Axes, limits: Bbox, **labels: str) -> None:
    """Give a panel limits, the same scale in both directions, and labels as of `axes.set`."""
    axes.set(aspect="equal", xlim=limits.intervalx, ylim=limits.intervaly, **labels)


def plane_axes(axes: Axes, limits: Bbox) -> None:
    """Make a panel a piece of the world."""
    equal_axes(axes, limits, xlabel="x (m)", ylabel="y (m)")
    axes.grid(visible=False)


def draw_ellipses(axes: Axes, centres: Points, half_axes: Points, **style: Any) -> None:
    """Draw one ellipse around each point, in the units of the panel."""
    widths, heights = 2 * half_axes.T
    style |= {"units": "xy", "offsets": centres, "offset_transform": axes.transData}
    axes.add_collection(EllipseCollection(widths, heights, np.zeros(len(centres)), **style))


def draw_prior(axes: Axes) -> None:
    """Draw the 1-sigma circle of a latent's prior N(0, I)."""
    axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, zorder=3, **PRIOR_LINE))


def draw_dots(axes: Axes, points: Points, colours: Colours, size: float = 4.0) -> None:
    """Draw a dot at each point."""
    x, y = points.T
    axes.scatter(x, y, c=colours, s=size, linewidths=0, zorder=2.5)


def draw_explored(
    axes: Axes, limits: Bbox, exploration: RecordedExploration, paths: Positions, colours: Colours
) -> None:
    """Draw goals in translucent regions, and one line per episode with a dot where it ends."""
    plane_axes(axes, limits)
    goals = exploration.goals
    opacity = float(np.clip(_DISC_INK / len(goals), *_DISC_OPACITY))
    look = {"facecolor": GREY, "edgecolor": "none", "alpha": opacity, "zorder": 0.5}
    draw_ellipses(axes, goals, np.full_like(goals, exploration.sparse_radius), **look)
    axes.plot(*goals.T, ".", color=DARK_GREY, markersize=2.5, markeredgewidth=0, zorder=0.6)
    lines = LineCollection(list(paths), colors=colours, linewidths=0.7, alpha=0.6, zorder=2)
    axes.add_collection(lines)
    draw_dots(axes, paths[:, -1], colours)


def directions(points: Points) -> Float[np.ndarray, " point"]:
    """Return the angle of each point seen from the origin, in degrees from the x axis."""
    return np.degrees(np.arctan2(points[:, 1], points[:, 0]))


def direction_scale(goals: Points) -> ScalarMappable:
    """Return a colour for each direction: one end of the goals' range to the other."""
    angles = directions(goals) / _ANGLE_STEP
    low, high = float(np.floor(angles.min())), float(np.ceil(angles.max()))
    norm = Normalize(_ANGLE_STEP * low, _ANGLE_STEP * max(high, low + 1))
    return ScalarMappable(norm, _DIRECTION_COLOURS)


def direction_bar(figure: Figure, axes: Sequence[Axes], scale: ScalarMappable, label: str) -> None:
    """Explain the colours of directions, once for all panels."""
    bar = figure.colorbar(scale, ax=list(axes), label=label, shrink=0.85, pad=0.02, aspect=25)
    bar.outline.set_linewidth(0.6)
    bar.ax.grid(visible=False)
    bar.ax.yaxis.set_major_locator(MultipleLocator(_ANGLE_STEP))
