"""The paper's Fig. 8: what the latent contributes to exploration."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from maesn.report.figures.latents import draw_prior
from maesn.report.figures.plane import (
    Limits,
    Positions,
    direction_bar,
    direction_scale,
    directions,
    draw_goals,
    draw_paths,
    equal_axes,
    final_positions,
    plane_axes,
    shared_limits,
)
from maesn.report.runs import RecordedExploration
from maesn.report.style import TWO_COLUMNS, new_figure, publication_style

_ABOVE_AND_BELOW = 0.8  # inches of titles and labels
_BESIDE = 1.7  # inches of labels and colour bar

Colours = Float[np.ndarray, "episode 4"]


@publication_style()
def plot_structured_noise(exploration: RecordedExploration) -> Figure:
    """Draw trajectories with the latent drawn from the prior beside those with it fixed.

    Colours are the direction in which an episode ends. If the drawn latents are known and have two
    components at least, a panel before them shows which latent went where.

    Raises:
        ValueError: if the exploration has no `fixed_paths`.
    """
    sampled, fixed = exploration.prior_paths, exploration.fixed_paths
    if fixed is None:
        raise ValueError("`exploration.fixed_paths` must be given, got None: no latents to fix.")
    limits = shared_limits([exploration.goals, sampled, fixed], exploration.sparse_radius)
    scale = direction_scale(exploration.goals)
    latents = exploration.prior_latents
    if latents is None or latents.shape[1] < 2:
        figure, panels = _panels(limits, widths=(1.0, 1.0))
    else:
        # As high as the planes beside it.
        figure, panels = _panels(limits, widths=(limits.aspect, 1.0, 1.0))
        _draw_latents(panels[0], latents, _colours(sampled, scale))
    titles = ("z sampled from the prior", "z fixed")
    for axes, paths, title in zip(panels[-2:], (sampled, fixed), titles, strict=True):
        plane_axes(axes, limits)
        draw_goals(axes, exploration.goals, exploration.sparse_radius)
        draw_paths(axes, paths, _colours(paths, scale))
        axes.set_title(f"{title}\nfinal positions spread {_spread(paths):.2f} m")
    panels[-1].set_ylabel("")
    panels[-1].tick_params(labelleft=False)
    direction_bar(figure, panels, scale, "final direction (°)")
    return figure


def _panels(limits: Limits, widths: tuple[float, ...]) -> tuple[Figure, list[Axes]]:
    """Return a figure with a row of panels, high enough for the plane."""
    height = (TWO_COLUMNS - _BESIDE) / sum(widths) * limits.aspect
    figure = new_figure(TWO_COLUMNS, height + _ABOVE_AND_BELOW)
    return figure, figure.subplots(1, len(widths), width_ratios=widths).tolist()


def _colours(paths: Positions, scale: ScalarMappable) -> Colours:
    return np.asarray(scale.to_rgba(directions(final_positions(paths))))


def _spread(paths: Positions) -> float:
    """Root mean square distance of the final positions from their mean, in metres."""
    return float(np.sqrt(final_positions(paths).var(0).sum()))


def _draw_latents(
    axes: Axes, latents: Float[np.ndarray, "episode context"], colours: Colours
) -> None:
    """Show the first two components of the drawn latents, in the colours of their episodes."""
    axes.scatter(latents[:, 0], latents[:, 1], c=colours, s=7, linewidths=0, zorder=2.5)
    draw_prior(axes)
    reach = np.full(2, 1.15 * float(np.abs(latents[:, :2]).max()))
    equal_axes(axes, Limits(-reach, reach))
    axes.set(xlabel="latent component 1", ylabel="latent component 2", title="the sampled z\n")
