"""The paper's Fig. 7: latent distributions before and after adaptation."""

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from maesn.report.figures import plane
from maesn.report.runs import Latents
from maesn.report.style import BLUE, GREY, TWO_COLUMNS, new_figure, publication_style

_PANEL_WIDTH = 2.5  # inches, of the plane alone
_SURROUNDINGS = 0.95  # inches of title, labels and legend


@publication_style()
def plot_latents(latents: Latents, goals: plane.Points | None = None) -> Figure:
    """Draw every task's latent distribution as its 1-sigma ellipse, before and after adaptation.

    The prior N(0, I) is a dashed circle of radius 1. Of more than two components, those whose means
    spread most after adaptation are drawn. The direction of a task's goal, where it is known, is
    the colour of its ellipse.
    """
    chosen = np.sort(np.argsort(-latents.mean[:, -1].var(0), kind="stable")[:2])
    mean, log_std = (x[:, [0, -1]][..., chosen] for x in (latents.mean, latents.log_std))
    std = np.exp(log_std)
    limits = plane.shared_limits([np.array([[-1.0, -1.0], [1.0, 1.0]]), mean - std, mean + std])
    figure = new_figure(TWO_COLUMNS, _PANEL_WIDTH * limits.aspect + _SURROUNDINGS)
    panels = figure.subplots(1, 2, sharex=True, sharey=True).tolist()
    colours = np.tile(to_rgba(BLUE), (len(mean), 1))
    if goals is not None:
        scale = plane.direction_scale(goals)
        colours = plane.direction_colours(scale, goals)
        plane.direction_bar(figure, panels, scale, "direction of the goal (°)")
    for column, later in enumerate((0, latents.mean.shape[1] - 1)):
        axes, centres = panels[column], mean[:, column]
        style = {"facecolors": "none", "edgecolors": colours, "linewidths": 0.7, "alpha": 0.8}
        plane.draw_ellipses(axes, centres, std[:, column], **style)
        plane.draw_dots(axes, centres, colours)
        plane.draw_prior(axes)
        plane.equal_axes(axes, limits, title=_title(latents.first_update + later))
        axes.set_xlabel(f"latent component {chosen[0] + 1}")
    panels[0].set_ylabel(f"latent component {chosen[1] + 1}")
    legend = {
        "prior N(0, I), 1σ": Line2D([], [], **plane.PRIOR_LINE),
        "a task's latent distribution, 1σ": Line2D([], [], color=GREY, linewidth=0.7),
    }
    figure.legend(legend.values(), legend.keys(), loc="outside lower center", ncols=2)
    return figure


def _title(update: int) -> str:
    if update == 0:
        return "before adaptation"
    return f"after {update} update" if update == 1 else f"after {update} updates"
