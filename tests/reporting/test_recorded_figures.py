"""Figures of what was recorded of runs: what is drawn of which tasks, and what is left out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_runs import (
    NUM_TASKS,
    adaptation_table,
    exploration,
    latents,
    line,
    write_exploration,
)

from maesn.reporting.comparison import Comparison
from maesn.reporting.reading import AdaptationTable
from maesn.reporting.report import plot_adapted_latents


def compared(directory: Path, table: AdaptationTable, components: int = 2) -> Comparison:
    """Return a comparison of one run, and write what was recorded of it."""
    write_exploration(directory / "maesn.npz", exploration())
    held = latents(components)
    part = {"mean": held.mean[: table.num_tasks], "log_std": held.log_std[: table.num_tasks]}
    np.savez(directory / "table.latents.npz", **vars(replace(held, **part)))
    one = replace(
        line("maesn", table),
        source="maesn",
        recorded=directory / "maesn.npz",
        files=(directory / "table.csv",),
    )
    return Comparison((one,))


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
    labels = [axes.get_ylabel() for axes in drawn.figure.axes]
    assert ("direction of the goal (°)" in labels) == is_coloured


def test_a_latent_of_one_component_has_no_plane(tmp_path: Path) -> None:
    assert plot_adapted_latents(compared(tmp_path, adaptation_table(), components=1)) is None
