"""A line of a figure: one method, adapted to the same tasks with every seed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from maesn.report.adaptation_table import JUDGED, AdaptationTable, stack_seeds
from maesn.report.style import MethodStyle


@dataclass(frozen=True)
class Line:
    """One method with the adaptation tables of its seeds."""

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
    def num_tasks(self) -> int:
        """Number of tasks; in a comparison the first ones of all."""
        return self.tables[0].num_tasks

    @property
    def first_beyond(self) -> int | None:
        """First column that lies beyond what meta-training has prepared for; None without one."""
        return self.tables[0].first_beyond

    @property
    def trial_episodes(self) -> int | None:
        """Number of episodes that meta-training has prepared for; None if there is no limit."""
        return self.tables[0].trial_episodes

    def measure(self, name: str) -> Float[np.ndarray, "seed task update"]:
        """Return one measure of all seeds."""
        return stack_seeds(self.tables, name)

    def of_tasks(self, chosen: Bool[np.ndarray, " task"]) -> "Line":
        """Return the line over some of the tasks.

        Args:
            chosen: of all tasks of the comparison, those that stay.
        """
        tables = tuple(table.select(chosen[: self.num_tasks]) for table in self.tables)
        return replace(self, tables=tables)


def note_on_judging(lines: Sequence[Line]) -> str:
    """Say which episodes the lines are judged on, by name where lines differ in it."""
    judged: dict[str, list[str]] = {}
    for line in lines:
        judged.setdefault(JUDGED[line.tables[0].purpose], []).append(line.label)
    if len(judged) == 1:
        return next(iter(judged))
    return "; ".join(f"{', '.join(labels)}: {how}" for how, labels in judged.items())
