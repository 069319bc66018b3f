"""Adaptation curves: the table of one run, and the line of a method with all its seeds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from maesn.reporting.style import MethodStyle
from maesn.storage import RunError

Curves = Float[np.ndarray, "task update"]

MEASURES = ("mean_return", "goal_return", "success_rate", "final_success_rate", "time_in_region")
COLUMNS = ("task", "update", "episodes", "purpose", *MEASURES, "solved_at_reset")

# Which episodes a row judges.
EXPLORE, DEPLOY = "explore", "deploy"
JUDGED = {
    EXPLORE: "judged on the episodes that were learned from, z drawn, as in the paper",
    DEPLOY: "judged on fresh episodes of the deployed agent",
}


class PriorReach(NamedTuple):
    """How broadly a policy explores before it has learned anything of its task."""

    share: float
    """Share of the tasks whose goal some episode reached."""
    episodes: int
    """Number of episodes per task."""
    num_tasks: int
    """Number of tasks, without those that are solved at reset."""


def prior_reach(
    success_rate: Float[np.ndarray, " task"],
    is_solved_at_reset: Bool[np.ndarray, " task"],
    episodes: int,
) -> PriorReach | None:
    """Return what the prior reaches; None if all tasks are solved at reset."""
    explored = success_rate[~is_solved_at_reset] > 0
    return PriorReach(float(explored.mean()), episodes, len(explored)) if len(explored) else None


@dataclass(frozen=True)
class AdaptationTable:
    """One `adaptation/<tasks>-<reward>.csv`: curves `[i, k]` of task i in column k.

    The measures (see `AdaptationCurves`) are those of the deployed agent where the file has them,
    else those of the episodes that were learned from.
    """

    tasks: str
    """Name of the task set."""
    reward: str
    purpose: str
    """What the measures judge, a key of `JUDGED`."""
    updates: Int[np.ndarray, " update"]
    """Number of updates that lie before each column; starts later if an adaptation continued."""
    episodes: Int[np.ndarray, " update"]
    """Episodes per task that the agent has learned from by then."""
    mean_return: Curves
    goal_return: Curves
    success_rate: Curves
    final_success_rate: Curves
    time_in_region: Curves
    solved_at_reset: Curves
    explored_success_rate: Float[np.ndarray, "task explored"]
    """`success_rate` of the episodes that were learned from, after every update."""
    explored_episodes: int | None = None
    """Episodes of each task that were played for an update; None if no record says so."""
    trial_episodes: int | None = None
    """Number of episodes that meta-training has prepared for; None if no record says so."""
    rule: str = ""
    """How figures call rule and wrappers; empty for the method as it is."""

    @property
    def num_tasks(self) -> int:
        """Number of tasks."""
        return int(self.mean_return.shape[0])

    @property
    def episodes_per_update(self) -> int | None:
        """Episodes per task that each update learns from; None if the table has a single column."""
        return int(self.episodes[1] - self.episodes[0]) if len(self.episodes) > 1 else None

    @property
    def first_beyond(self) -> int | None:
        """First column that lies beyond what meta-training has prepared for; None without one."""
        if self.trial_episodes is None:
            return None
        column = int(np.searchsorted(self.episodes, self.trial_episodes))
        return column if column < len(self.episodes) else None

    @property
    def is_solved_at_reset(self) -> Bool[np.ndarray, " task"]:
        """Which tasks some episode starts in the goal region of."""
        return np.asarray((self.solved_at_reset > 0).any(axis=1))

    @property
    def prior_reach(self) -> PriorReach | None:
        """What the prior reaches; None if the table does not tell."""
        episodes = self.explored_episodes or self.episodes_per_update
        if self.updates[0] or episodes is None:
            return None
        return prior_reach(self.explored_success_rate[:, 0], self.is_solved_at_reset, episodes)

    def measure(self, name: str) -> Curves:
        """Return the curves of one of `MEASURES`."""
        return np.asarray(getattr(self, name))

    def part(
        self, tasks: slice | Bool[np.ndarray, " task"], columns: slice = slice(None)
    ) -> "AdaptationTable":
        """Return the table of some of the tasks and updates."""
        changed: dict[str, Any] = {
            name: x[tasks][:, columns] if x.ndim == 2 else x[columns]
            for name, x in vars(self).items()
            if isinstance(x, np.ndarray)
        }
        return replace(self, **changed)


def stack_seeds(
    tables: Sequence[AdaptationTable], measure: str
) -> Float[np.ndarray, "seed task update"]:
    """Return one measure of several seeds; a `RunError` says if they were not adapted alike."""
    extents = sorted({(t.num_tasks, int(t.updates[0]), int(t.updates[-1])) for t in tables})
    if len(extents) > 1:
        found = " and ".join("{} tasks, updates {} to {}".format(*extent) for extent in extents)
        raise RunError(
            f"Expected every seed to be adapted alike, got {found} ({tables[0].tasks} tasks); "
            "run `maesn adapt` with the same `--tasks` and `--episodes` for each."
        )
    return np.stack([table.measure(measure) for table in tables])


def solved_at_reset(tables: Sequence[AdaptationTable]) -> Bool[np.ndarray, " task"]:
    """Return which tasks some episode of some run starts in the goal region of."""
    return np.asarray(np.any([table.is_solved_at_reset for table in tables], axis=0))


@dataclass(frozen=True)
class Line:
    """A line of a figure: one method, adapted to the same tasks with every seed."""

    name: str
    """For file names."""
    style: MethodStyle
    seeds: tuple[int, ...]
    tables: tuple[AdaptationTable, ...]
    """One per seed, all of the same tasks and with as many updates."""
    training_steps: int | None = None
    """Environment steps of meta-training; None without any."""

    @property
    def label(self) -> str:
        """How figures and tables call the method."""
        return self.style.label

    @property
    def table(self) -> AdaptationTable:
        """The first seed's table; its tasks, updates and budgets are those of all seeds."""
        return self.tables[0]

    @property
    def num_tasks(self) -> int:
        """Number of tasks; in a comparison the first ones of all."""
        return self.table.num_tasks

    def measure(self, name: str) -> Float[np.ndarray, "seed task update"]:
        """Return one measure of all seeds."""
        return stack_seeds(self.tables, name)

    def of_tasks(self, chosen: Bool[np.ndarray, " task"]) -> "Line":
        """Return the line over those of the comparison's tasks that are chosen."""
        tables = tuple(table.part(chosen[: self.num_tasks]) for table in self.tables)
        return replace(self, tables=tables)


def note_on_judging(lines: Sequence[Line]) -> str:
    """Say which episodes the lines are judged on, by name where lines differ in it."""
    judged = by_text({line.label: JUDGED[line.table.purpose] for line in lines})
    if len(judged) == 1:
        return next(iter(judged))
    return "; ".join(f"{', '.join(labels)}: {how}" for how, labels in judged.items())


def by_text(said: Mapping[str, str]) -> dict[str, list[str]]:
    """Return of which lines a text is said, by the text."""
    return {text: [name for name in said if said[name] == text] for text in said.values()}
