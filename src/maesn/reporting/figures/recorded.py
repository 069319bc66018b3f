"""Figures of runs in a study: tasks, exploration and latents, each of the first seed."""

from maesn.reporting.comparison import Comparison, Line
from maesn.reporting.figures import exploration
from maesn.reporting.reading import prior_reach
from maesn.reporting.runs import Latents, RecordedExploration, read_record
from maesn.reporting.style import Drawn

_REMEDY = "run the study again"


def plot_tasks(comparison: Comparison) -> Drawn | None:
    """Draw the tasks of training and those adapted to; None if nothing was recorded."""
    found = _recorded(comparison)
    return exploration.plot_task_distribution(next(iter(found.values()))[1]) if found else None


def plot_paths(comparison: Comparison) -> Drawn | None:
    """Draw what each run explores before adaptation; None if nothing was recorded."""
    panels = [_panel(line, record) for line, record in _recorded(comparison).values()]
    return exploration.plot_exploration(panels) if panels else None


def plot_noise(comparison: Comparison) -> Drawn | None:
    """Draw paths with z drawn and with z held; None if no run with a latent was recorded."""
    found = [record for _, record in _recorded(comparison).values()]
    held = next((one for one in found if one.fixed_paths is not None), None)
    return None if held is None else exploration.plot_structured_noise(held)


def plot_adapted_latents(comparison: Comparison) -> Drawn | None:
    """Draw the latents of all tasks before and after adaptation; None if no line has them."""
    line = next((line for line in comparison.lines if line.latents is not None), None)
    if line is None or line.latents is None:
        return None
    found = _recorded(comparison).get(line.source)
    goals = None if found is None else found[1].goals
    latents = read_record(Latents, line.latents, _REMEDY)
    fits = goals is not None and len(goals) == len(latents.mean)
    return exploration.plot_latents(latents, goals if fits else None)


def _recorded(comparison: Comparison) -> dict[str, tuple[Line, RecordedExploration]]:
    """Return, by the name of a run, its first line and what was recorded of it."""
    lines = {line.source: line for line in reversed(comparison.lines)}
    return {
        name: (lines[name], read_record(RecordedExploration, path, _REMEDY))
        for name, path in comparison.recorded.items()
        if name in lines
    }


def _panel(line: Line, record: RecordedExploration) -> exploration.ExplorationPanel:
    """Return a run's panel, with the goals that it reaches before its first update."""
    table, reach = line.table, None
    episodes = table.explored_episodes or table.episodes_per_update
    if episodes is not None and table.num_tasks == len(record.goals):
        first = table.explored_success_rate[0, :, 0]
        reach = prior_reach(first, table.is_solved_at_reset, episodes)
    return exploration.ExplorationPanel(line.style, record, reach)
