"""Reports of runs and of studies: figures and tables, from the files that they left."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from maesn.reporting.comparison import Comparison, Line, tidy_rows
from maesn.reporting.figures import exploration
from maesn.reporting.figures.curves import (
    learning_charts,
    plot_charts,
    plot_curves,
    plot_ends,
    plot_profiles,
)
from maesn.reporting.runs import RECORDED_TASKS, Latents, RecordedExploration, read_recorded
from maesn.reporting.sources import Compared
from maesn.reporting.style import save_figure
from maesn.reporting.tables import TextTable, summary_tables, to_page
from maesn.storage import write_rows, write_whole

RESULTS, SUMMARY = "results.csv", "summary.md"

_EVERYTHING = {"name": "comparison", "kind": "curves"}


class Reported(NamedTuple):
    """The files and tables of a report."""

    files: list[Path]  # figures, and the page
    tables: list[TextTable]
    """For each comparison: the ends of all methods, the way there, and who beats whom."""


def write_report(study: Compared, out: Path) -> Reported:
    """Draw every figure that there is data for, each as a PNG and a PDF, and make the tables.

    The figures of runs go into `out`. Those of a study go into a folder for each comparison, beside
    a summary; all results of a study go into one table. A `RunError` says which file is broken.
    """
    files: list[Path] = []
    tables: list[TextTable] = []
    for reward, charts in learning_charts(study.series).items():
        files += save_figure(plot_charts(charts), out, f"learning-{reward}")
    rows = ({"comparison": x.name, **row} for x in study.comparisons for row in tidy_rows(x))
    if study.comparisons and not study.series:
        write_rows(out / RESULTS, rows)
    has_curves = any(one["kind"] == "curves" for one in study.figures)
    figures = study.figures if has_curves else [_EVERYTHING, *study.figures]
    for one in study.comparisons:
        found, folder = summary_tables(one), out
        if not study.series:
            folder = out / one.name
            write_whole(folder / SUMMARY, to_page(found).encode())
        for figure in figures:
            files += _draw(one, figure, folder)
        tables += found
    return Reported(files, tables)


def _draw(comparison: Comparison, figure: Mapping[str, Any], out: Path) -> list[Path]:
    chosen = {*figure.get("lines", ())}
    lines = tuple(one for one in comparison.lines if not chosen or chosen & {one.name, one.source})
    if not lines or comparison.family not in (figure.get("families") or [comparison.family]):
        return []
    picture = _KINDS[figure["kind"]](replace(comparison, lines=lines))
    return save_figure(picture, out, f"{figure['name']}-{comparison.name}") if picture else []


def plot_tasks(comparison: Comparison) -> Figure | None:
    """Draw the tasks of training and those adapted to; None if nothing was recorded."""
    found = _recorded(comparison)
    return exploration.plot_task_distribution(found[0][1]) if found else None


def plot_paths(comparison: Comparison) -> Figure | None:
    """Draw what each run explores before adaptation; None if nothing was recorded."""
    panels = []
    for line, record in _recorded(comparison):
        # The share is over the goals and regions that are drawn.
        has_goals = line.table.tasks == RECORDED_TASKS and line.num_tasks == len(record.goals)
        has_regions = comparison.sparse_radius in (None, record.sparse_radius)
        reach = line.table.prior_reach if has_goals and has_regions else ""
        panels.append((line.style, record, reach))
    return exploration.plot_exploration(panels) if panels else None


def plot_noise(comparison: Comparison) -> Figure | None:
    """Draw paths with z drawn and with z held, of the first run with a latent; None without one."""
    found = [record for _, record in _recorded(comparison) if record.fixed_paths is not None]
    return exploration.plot_structured_noise(found[0]) if found else None


def plot_adapted_latents(comparison: Comparison) -> Figure | None:
    """Draw the latents, of two components or more, of the first method that has such."""
    goals = {line.source: record.goals for line, record in _recorded(comparison)}
    for line in comparison.lines:
        latents = line.latents and read_recorded(Latents, line.latents)
        if latents and latents.mean.shape[-1] > 1:
            has_goals = line.source in goals and line.table.tasks == RECORDED_TASKS
            known = goals[line.source][: line.num_tasks] if has_goals else None
            return exploration.plot_latents(latents, known)
    return None


def _recorded(comparison: Comparison) -> list[tuple[Line, RecordedExploration]]:
    """Return each run that something was recorded of: its first line, and the record."""
    found: dict[str, tuple[Line, RecordedExploration]] = {}
    for line in comparison.lines:
        record = line.recorded and read_recorded(RecordedExploration, line.recorded)
        if record:
            found.setdefault(line.source, (line, record))
    return [*found.values()]


_KINDS = {
    "curves": plot_curves,
    "dots": plot_ends,
    "profiles": plot_profiles,
    "tasks": plot_tasks,
    "exploration": plot_paths,
    "noise": plot_noise,
    "latents": plot_adapted_latents,
}
