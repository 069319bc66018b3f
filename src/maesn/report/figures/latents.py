"""The paper's Fig. 7: latent distributions before and after adaptation."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from maesn.report.figures.plane import (
    direction_bar,
    direction_scale,
    directions,
    equal_axes,
    shared_limits,
)
from maesn.report.reading import Latents
from maesn.report.style import BLACK, BLUE, GREY, TWO_COLUMNS, new_figure, publication_style

_PANEL_WIDTH = 2.5  # inches, of the plane alone
_SURROUNDINGS = 0.95  # inches of title, labels and legend

_PRIOR_LINE: dict[str, Any] = {"color": BLACK, "linestyle": "--", "linewidth": 1.0}

Goals = Float[np.ndarray, "task 2"]


@publication_style()
def plot_latents(latents: Latents, goals: Goals | None = None) -> Figure:
    """Draw every task's latent distribution as its 1-sigma ellipse, before and after adaptation.

    The prior N(0, I) is a dashed circle of radius 1. Of more than two components, those whose means
    spread most after adaptation are drawn.

    Args:
        latents: of all updates; at least two components.
        goals: goal of each task; its direction then is the colour of its ellipse.

    Raises:
        ValueError: if a latent has fewer than two components.
    """
    num_tasks, _, num_components = latents.mean.shape
    if num_components < 2:
        raise ValueError(
            f"`latents` must have at least 2 components to draw ellipses, got {num_components}."
        )
    chosen = np.sort(np.argsort(-latents.mean[:, -1].var(0), kind="stable")[:2])
    mean, log_std = (x[:, [0, -1]][..., chosen] for x in (latents.mean, latents.log_std))
    std = np.exp(log_std)
    limits = shared_limits([np.array([[-1.0, -1.0], [1.0, 1.0]]), mean - std, mean + std])
    figure = new_figure(TWO_COLUMNS, _PANEL_WIDTH * limits.aspect + _SURROUNDINGS)
    panels = figure.subplots(1, 2, sharex=True, sharey=True).tolist()
    scale = None if goals is None else direction_scale(goals)
    colours = _colours(goals, scale, num_tasks)
    for column, update in enumerate((latents.first_update, latents.last_update)):
        axes = panels[column]
        _draw_ellipses(axes, mean[:, column], std[:, column], colours)
        draw_prior(axes)
        equal_axes(axes, limits)
        axes.set(title=_title(update), xlabel=f"latent component {chosen[0] + 1}")
    panels[0].set_ylabel(f"latent component {chosen[1] + 1}")
    _add_legend(figure)
    if scale is not None:
        direction_bar(figure, panels, scale, "direction of the goal (°)")
    return figure


def _title(update: int) -> str:
    if update == 0:
        return "before adaptation"
    return f"after {update} update" if update == 1 else f"after {update} updates"


def _colours(
    goals: Goals | None, scale: ScalarMappable | None, num_tasks: int
) -> Float[np.ndarray, "task 4"]:
    if goals is None or scale is None:
        return np.tile(to_rgba(BLUE), (num_tasks, 1))
    return np.asarray(scale.to_rgba(directions(goals)))


def _draw_ellipses(
    axes: Axes,
    mean: Float[np.ndarray, "task 2"],
    std: Float[np.ndarray, "task 2"],
    colours: Float[np.ndarray, "task 4"],
) -> None:
    ellipses = EllipseCollection(
        2 * std[:, 0],
        2 * std[:, 1],
        np.zeros(len(mean)),
        units="xy",
        offsets=mean,
        offset_transform=axes.transData,
        facecolors="none",
        edgecolors=colours,
        linewidths=0.7,
        alpha=0.8,
    )
    axes.add_collection(ellipses)
    axes.scatter(mean[:, 0], mean[:, 1], c=colours, s=4, linewidths=0, zorder=2.5)


def draw_prior(axes: Axes) -> None:
    """Draw the 1-sigma circle of the prior N(0, I)."""
    axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, zorder=3, **_PRIOR_LINE))


def _add_legend(figure: Figure) -> None:
    lines = {
        "prior N(0, I), 1σ": Line2D([], [], **_PRIOR_LINE),
        "a task's latent distribution, 1σ": Line2D([], [], color=GREY, linewidth=0.7),
    }
    figure.legend(lines.values(), lines.keys(), loc="outside lower center", ncols=2)
