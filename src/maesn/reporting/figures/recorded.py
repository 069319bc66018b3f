"""Figures of runs in a study: tasks, exploration and latents, each of the first seed."""

from maesn.reporting.comparison import Comparison, Line
from maesn.reporting.figures import exploration
from maesn.reporting.runs import RECORDED_TASKS, Latents, RecordedExploration, read_record
from maesn.reporting.style import Drawn

_REMEDY = "run the study again"


def plot_tasks(comparison: Comparison) -> Drawn | None:
    """Draw the tasks of training and those adapted to; None if nothing was recorded."""
    found = _recorded(comparison)
    return exploration.plot_task_distribution(next(iter(found.values()))[1]) if found else None


def plot_paths(comparison: Comparison) -> Drawn | None:
    """Draw what each run explores before adaptation; None if nothing was recorded."""
    panels = []
    for line, record in _recorded(comparison).values():
        # Only of the goals that are drawn, and within the regions that are drawn.
        has_goals = line.table.tasks == RECORDED_TASKS and line.num_tasks == len(record.goals)
        has_regions = comparison.sparse_radius in (None, record.sparse_radius)
        reach = line.table.prior_reach if has_goals and has_regions else None
        panels.append(exploration.ExplorationPanel(line.style, record, reach))
    return exploration.plot_exploration(panels) if panels else None


def plot_noise(comparison: Comparison) -> Drawn | None:
    """Draw paths with z drawn and with z held; None if no run with a latent was recorded."""
    found = [record for _, record in _recorded(comparison).values()]
    held = next((one for one in found if one.fixed_paths is not None), None)
    return None if held is None else exploration.plot_structured_noise(held)


def plot_adapted_latents(comparison: Comparison) -> Drawn | None:
    """Draw the latents of all tasks before and after adaptation; None if no line has such.

    A latent of one component has no plane.
    """
    recorded = _recorded(comparison)
    for line in comparison.lines:
        latents = None if line.latents is None else read_record(Latents, line.latents, _REMEDY)
        if latents is None or latents.mean.shape[-1] < 2:
            continue
        goals = None
        if line.source in recorded and line.table.tasks == RECORDED_TASKS:
            goals = recorded[line.source][1].goals[: line.num_tasks]
        return exploration.plot_latents(latents, goals)
    return None


def _recorded(comparison: Comparison) -> dict[str, tuple[Line, RecordedExploration]]:
    """Return, by the name of a run, its first line and what was recorded of it."""
    lines = {line.source: line for line in reversed(comparison.lines)}
    return {
        name: (lines[name], read_record(RecordedExploration, path, _REMEDY))
        for name, path in comparison.recorded.items()
        if name in lines
    }
