"""What is explored before adaptation, and how latents adapt: the paper's Fig. 4 (right), 6 to 8."""

import math
import textwrap
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.transforms import Bbox

from maesn.reporting import style
from maesn.reporting.figures import plane
from maesn.reporting.reading import prior_reach
from maesn.reporting.runs import Latents, RecordedExploration
from maesn.reporting.statistics import count

_TITLE_CHARACTERS = 32  # across the narrowest panel
_PANEL_WIDTH = 2.5  # inches of the plane of latents alone
_SURROUNDINGS = 0.95  # inches of its title, labels and legend


class ExplorationPanel(NamedTuple):
    """What one method explores before adaptation."""

    style: style.MethodStyle
    exploration: RecordedExploration
    reach: str
    """How many of the goals it reaches; empty if that was not counted."""


@style.publication_style()
def plot_task_distribution(exploration: RecordedExploration) -> style.Drawn:
    """Draw the goals of training, those adapted to, and the size of one goal region.

    What a task lays out beside its goal, such as blocks, is drawn as well.
    """
    training, goals = exploration.training_goals, exploration.goals
    radius, start = exploration.sparse_radius, exploration.prior_paths[:, 0].mean(0, keepdims=True)
    middle = goals[np.argmin(np.linalg.norm(goals - goals.mean(0), axis=-1))]
    landmarks = (
        ("training tasks", exploration.training_landmarks, style.VERMILLION),
        ("tasks adapted to", exploration.landmarks, style.BLUE),
    )
    # Once each: several tasks may share a layout.
    objects = [
        (np.unique(array.reshape(-1, 2), axis=0), "s", colour, f"objects of {tasks}")
        for tasks, array, colour in landmarks
        if array is not None
    ]
    positions = [middle[None], goals, training, start, *(points for points, *_ in objects)]
    limits = plane.shared_limits(positions, radius)
    # Beside the plane labels take 0.6 inches, above and below it labels and legend take 0.85.
    height = (style.ONE_COLUMN - 0.6) * limits.height / limits.width + 0.85
    figure = style.new_figure(style.ONE_COLUMN, height)
    axes = figure.subplots()
    _mark(axes, training, "o", style.VERMILLION, f"{len(training)} training goals", alpha=0.7)
    crosses = f"{len(goals)} goals adapted to"
    _mark(axes, goals, "x", style.BLUE, crosses, markeredgewidth=0.9)
    region = Circle((float(middle[0]), float(middle[1])), radius, facecolor=style.BLUISH_GREEN)
    region.set(alpha=0.2, linewidth=0, zorder=0.5, label=f"goal region ({radius:g} m)")
    axes.add_patch(region)
    for one in objects:
        _mark(axes, *one, markeredgewidth=0.7, fillstyle="none")
    _mark(axes, start, "+", style.BLACK, "start", markersize=6, markeredgewidth=1.0, zorder=3)
    plane.plane_axes(axes, limits)
    figure.legend(loc="outside lower center", ncols=2, columnspacing=1.2)
    return style.Drawn(figure)


def _mark(
    axes: Axes, points: plane.Points, marker: str, colour: str, label: str, **changed: Any
) -> None:
    look = {"markersize": 3.5, "markeredgewidth": 0, **changed}
    axes.plot(*points.T, marker, color=colour, label=label, **look)


@style.publication_style()
def plot_exploration(explorers: Sequence[ExplorationPanel]) -> style.Drawn:
    """Draw trajectories from the prior over the goals, and an untrained policy's beside them.

    The untrained policy is that of the first run. All are in one world.
    """
    first = explorers[0].exploration
    solved, episodes = first.solved_at_reset > 0, first.episodes_per_task
    reach = prior_reach(first.untrained_success_rate, solved, episodes)
    untrained = ExplorationPanel(style.MethodStyle("untrained policy", style.BLACK), first, reach)
    drawn = [(one, one.exploration.prior_paths) for one in explorers]
    drawn.append((untrained, first.untrained_paths))
    limits = plane.shared_limits([first.goals, *(paths for _, paths in drawn)], first.sparse_radius)
    columns = 2 if len(drawn) in (2, 4) else 3
    rows = math.ceil(len(drawn) / columns)
    # Labels take 0.5 inches of a row and 0.4 below the last one, the title 0.42 of each.
    height = (style.TWO_COLUMNS - 0.5) / columns * limits.height / limits.width + 0.42
    figure = style.new_figure(style.TWO_COLUMNS, rows * height + 0.4)
    panels = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for unused in panels[len(drawn) :]:
        unused.remove()
    for position, (one, paths) in enumerate(drawn):
        axes = panels[position]
        plane.draw_explored(axes, limits, one.exploration, paths, one.style.colour)
        title = textwrap.fill(one.style.label, _TITLE_CHARACTERS)
        axes.set_title(f"{title}\n{one.reach}".rstrip())
        if position % columns:
            axes.set_ylabel("")
            axes.tick_params(labelleft=False)
        if position + columns < len(drawn):
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)
    return style.Drawn(figure)


@style.publication_style()
def plot_structured_noise(exploration: RecordedExploration) -> style.Drawn:
    """Draw trajectories with the latent drawn from the prior beside those with it fixed.

    Colours are the direction in which an episode ends. If the drawn latents are known and have two
    components at least, a panel before them shows which latent went where.
    """
    sampled, fixed = exploration.prior_paths, exploration.fixed_paths
    assert fixed is not None  # methods without latents have no such figure
    limits = plane.shared_limits([exploration.goals, sampled, fixed], exploration.sparse_radius)
    scale = plane.direction_scale(exploration.goals)
    latents = exploration.prior_latents
    if latents is not None and latents.shape[1] < 2:
        latents = None
    # The panel of latents is as high as the planes beside it.
    widths = [1.0, 1.0] if latents is None else [limits.height / limits.width, 1.0, 1.0]
    # Beside the panels labels and colour bar take 1.7 inches, above and below them text takes 0.8.
    height = (style.TWO_COLUMNS - 1.7) / sum(widths) * limits.height / limits.width + 0.8
    figure = style.new_figure(style.TWO_COLUMNS, height)
    panels = figure.subplots(1, len(widths), width_ratios=widths).tolist()
    drawn = {"z sampled from the prior": sampled, "z fixed": fixed}
    for axes, (title, paths) in zip(panels[-2:], drawn.items(), strict=True):
        colours = scale.to_rgba(plane.directions(paths[:, -1]))
        plane.draw_explored(axes, limits, exploration, paths, colours)
        # Root mean square distance from their mean.
        spread = float(np.sqrt(paths[:, -1].var(0).sum()))
        axes.set_title(f"{title}\nfinal positions spread {spread:.2f} m")
    if latents is not None:
        colours = scale.to_rgba(plane.directions(sampled[:, -1]))
        plane.draw_dots(panels[0], latents[:, :2], colours, size=7.0)
        plane.draw_prior(panels[0])
        reach = 1.15 * float(np.abs(latents[:, :2]).max())
        box = Bbox([[-reach, -reach], [reach, reach]])
        labels = {"xlabel": "latent component 1", "ylabel": "latent component 2"}
        plane.equal_axes(panels[0], box, title="the sampled z\n", **labels)
    panels[-1].label_outer()
    plane.direction_bar(figure, panels, scale, "final direction (°)")
    return style.Drawn(figure)


@style.publication_style()
def plot_latents(latents: Latents, goals: plane.Points | None = None) -> style.Drawn:
    """Draw every task's latent distribution as its 1-sigma ellipse, before and after adaptation.

    The prior N(0, I) is a dashed circle of radius 1. Of more than two components, those whose means
    spread most after adaptation are drawn. The direction of a task's goal, where it is known, is
    the colour of its ellipse.
    """
    chosen = np.sort(np.argsort(-latents.mean[:, -1].var(0), kind="stable")[:2])
    mean, log_std = (x[:, [0, -1]][..., chosen] for x in (latents.mean, latents.log_std))
    std = np.exp(log_std)
    limits = plane.shared_limits([np.array([[-1.0, -1.0], [1.0, 1.0]]), mean - std, mean + std])
    height = _PANEL_WIDTH * limits.height / limits.width + _SURROUNDINGS
    figure = style.new_figure(style.TWO_COLUMNS, height)
    panels = figure.subplots(1, 2, sharex=True, sharey=True).tolist()
    colours = np.tile(to_rgba(style.BLUE), (len(mean), 1))
    if goals is not None:
        scale = plane.direction_scale(goals)
        colours = scale.to_rgba(plane.directions(goals))
        plane.direction_bar(figure, panels, scale, "direction of the goal (°)")
    for column, later in enumerate((0, latents.mean.shape[1] - 1)):
        axes, centres = panels[column], mean[:, column]
        outline = {"facecolors": "none", "edgecolors": colours, "linewidths": 0.7, "alpha": 0.8}
        plane.draw_ellipses(axes, centres, std[:, column], **outline)
        plane.draw_dots(axes, centres, colours)
        plane.draw_prior(axes)
        update = latents.first_update + later
        title = f"after {count(update, 'update')}" if update else "before adaptation"
        plane.equal_axes(axes, limits, title=title)
        axes.set_xlabel(f"latent component {chosen[0] + 1}")
    panels[0].set_ylabel(f"latent component {chosen[1] + 1}")
    legend = {
        "prior N(0, I), 1σ": Line2D([], [], **plane.PRIOR_LINE),
        "a task's latent distribution, 1σ": Line2D([], [], color=style.GREY, linewidth=0.7),
    }
    figure.legend(legend.values(), legend.keys(), loc="outside lower center", ncols=2)
    return style.Drawn(figure)
