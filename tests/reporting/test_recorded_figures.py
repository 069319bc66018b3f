"""Figures of what was recorded of runs: what is drawn of which tasks, and what is left out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_runs import (
    NUM_TASKS,
    RADIUS,
    adaptation_table,
    exploration,
    latents,
    line,
    write_exploration,
)

from maesn.reporting.comparison import Comparison
from maesn.reporting.reading import AdaptationTable
from maesn.reporting.report import plot_adapted_latents, plot_paths


def compared(
    directory: Path, table: AdaptationTable, components: int = 2, radius: float = RADIUS
) -> Comparison:
    """Return a comparison of one run, with two seeds, and write what was recorded of it."""
    write_exploration(directory / "maesn.npz", exploration())
    held = latents(components)
    part = {"mean": held.mean[: table.num_tasks], "log_std": held.log_std[: table.num_tasks]}
    np.savez(directory / "table.latents.npz", **vars(replace(held, **part)))
    one = replace(
        line("maesn", table, replace(table, explored_success_rate=0 * table.success_rate)),
        source="maesn",
        recorded=directory / "maesn.npz",
        files=(directory / "table.csv",),
    )
    return Comparison((one,), sparse_radius=radius)


@pytest.mark.parametrize(
    ("tasks", "num_tasks", "is_coloured"),
    [("test", NUM_TASKS, True), ("test", 3, True), ("validation", NUM_TASKS, False)],
)
def test_latents_have_the_colours_of_their_own_goals(
    tmp_path: Path, tasks: str, num_tasks: int, is_coloured: bool
) -> None:
    table = replace(adaptation_table(num_tasks), tasks=tasks)
    drawn = plot_adapted_latents(compared(tmp_path, table))
    assert drawn is not None
    labels = [axes.get_ylabel() for axes in drawn.axes]
    assert ("direction of the goal (°)" in labels) == is_coloured


def test_a_latent_of_one_component_has_no_plane(tmp_path: Path) -> None:
    assert plot_adapted_latents(compared(tmp_path, adaptation_table(), components=1)) is None


def test_a_share_of_goals_is_said_of_those_that_are_drawn(tmp_path: Path) -> None:
    def title(comparison: Comparison) -> str:
        drawn = plot_paths(comparison)
        assert drawn is not None
        return drawn.axes[0].get_title()

    table = adaptation_table()
    share = (table.explored_success_rate[:, 0] > 0).mean()  # of the first seed
    assert share > 0
    said = f"MAESN\n{share:.0%} of the goals in 50 episodes"
    assert title(compared(tmp_path, table)) == said
    single = replace(table, about={"episodes_per_update": 1})
    assert title(compared(tmp_path, single)) == said.replace("50 episodes", "1 episode")
    assert title(compared(tmp_path, replace(table, tasks="validation"))) == "MAESN"
    assert title(compared(tmp_path, table, radius=0.3)) == "MAESN"
