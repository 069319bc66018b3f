"""Adaptation curves of one run, read from the CSV file that `maesn adapt` writes."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from maesn.report.table_name import table_name
from maesn.storage import RunError, read_json

Curves = Float[np.ndarray, "task update"]

MEASURES = ("mean_return", "goal_return", "success_rate", "final_success_rate", "time_in_region")
COLUMNS = ("task", "update", "episodes", *MEASURES)
# Tables of earlier versions lack it; whatever reads one must do without.
SOLVED_AT_RESET = "solved_at_reset"


class PriorReach(NamedTuple):
    """How broadly a policy explores before it has learned anything of its task."""

    share: float
    """Share of the tasks whose goal some episode reached."""
    episodes: int
    """Number of episodes per task."""
    num_tasks: int
    """Number of tasks; those that are solved at reset are no matter of exploration."""


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
    """One `adaptation/<tasks>-<reward>.csv`: entry `[i, k]` is task i in column k."""

    tasks: str
    """Name of the task set."""
    reward: str
    """Reward of the adaptation, "sparse" or "dense"."""
    episodes: Int[np.ndarray, " update"]
    """Episodes per task that the agent has learned from by then."""
    mean_return: Curves
    """Mean undiscounted return."""
    goal_return: Curves
    """The part of it that is due to the goal."""
    success_rate: Curves
    """Share of the episodes that reach the goal region at some time."""
    final_success_rate: Curves
    """Share of the episodes that end in the goal region."""
    time_in_region: Curves
    """Share of the steps that are spent in the goal region."""
    first_update: int = 0
    """Number of updates that lie before column 0; not 0 if an earlier adaptation went on."""
    solved_at_reset: Curves | None = None
    """Share of the episodes that start in the goal region; None in tables of earlier versions."""
    episodes_per_task: int | None = None
    """Episodes that each entry is a mean of; None if no record says so."""
    trial_episodes: int | None = None
    """Number of episodes that meta-training has prepared for; None if there is no such limit, or no
    record says so."""

    @property
    def num_tasks(self) -> int:
        """Number of tasks."""
        return int(self.mean_return.shape[0])

    @property
    def updates(self) -> Int[np.ndarray, " update"]:
        """Number of updates that lie before each column."""
        return np.arange(self.first_update, self.first_update + len(self.episodes))

    @property
    def episodes_per_update(self) -> int | None:
        """Episodes per task that each update learns from; None if the table has a single column."""
        return int(self.episodes[1] - self.episodes[0]) if len(self.episodes) > 1 else None

    @property
    def first_beyond(self) -> int | None:
        """First column that lies beyond what meta-training has prepared for; None without one."""
        if self.trial_episodes is None:
            return None
        beyond = np.flatnonzero(self.episodes >= self.trial_episodes)
        return int(beyond[0]) if len(beyond) else None

    @property
    def is_solved_at_reset(self) -> Bool[np.ndarray, " task"]:
        """Which tasks some episode starts in the goal region of; none if the table does not say."""
        if self.solved_at_reset is None:
            return np.zeros(self.num_tasks, bool)
        return np.asarray((self.solved_at_reset > 0).any(axis=1))

    def select(self, tasks: Bool[np.ndarray, " task"]) -> "AdaptationTable":
        """Return the table of some of the tasks."""
        names = MEASURES if self.solved_at_reset is None else (*MEASURES, SOLVED_AT_RESET)
        return replace(self, **{name: getattr(self, name)[tasks] for name in names})

    @property
    def prior_reach(self) -> PriorReach | None:
        """What the prior reaches; None if the table does not tell."""
        episodes = self.episodes_per_task or self.episodes_per_update
        if self.first_update or episodes is None:
            return None
        rates, solved = self.success_rate[:, 0], self.is_solved_at_reset
        return prior_reach(rates, solved, episodes)

    def measure(self, name: str) -> Curves:
        """Return the curves of one of `MEASURES`."""
        curves: Curves = getattr(self, name)
        return curves


def stack_seeds(
    tables: Sequence[AdaptationTable], measure: str
) -> Float[np.ndarray, "seed task update"]:
    """Return one measure of several runs that differ in their seed.

    Raises:
        RunError: if the runs were not adapted to as many tasks, or not with as many updates.
    """
    extents = sorted({(t.num_tasks, t.first_update, int(t.updates[-1])) for t in tables})
    if len(extents) > 1:
        found = " and ".join("{} tasks, updates {} to {}".format(*extent) for extent in extents)
        raise RunError(
            f"Expected every seed to be adapted alike, got {found} ({tables[0].tasks} tasks); "
            "run `maesn adapt` with the same `--tasks` and `--updates` for each."
        )
    return np.stack([table.measure(measure) for table in tables])


def read_adaptation(path: Path) -> AdaptationTable:
    """Read a CSV file of `maesn adapt`, and its record where there is one beside it.

    Args:
        path: `<tasks>-<reward>.csv`; rows in any order.

    Raises:
        RunError: if a column, a row or a number is missing, or a row occurs twice.
    """
    rows = _read_rows(path)
    first = min((int(row["update"]) for row in rows), default=0)
    episodes = _grid(rows, "episodes", first, path)
    if (episodes != episodes[:1]).any():
        raise RunError(
            f"Expected the same `episodes` for every task in `{path}`, got different ones; "
            f"{_remedy(path)}."
        )
    name = table_name(path)
    present = [name for name in (*MEASURES, SOLVED_AT_RESET) if name in rows[0]]
    curves: dict[str, Any] = {name: _grid(rows, name, first, path) for name in present}
    counts = episodes[0].astype(np.int64)
    table = AdaptationTable(name.tasks, name.reward, counts, **curves, first_update=first)
    return replace(table, **_recorded(path))


def _recorded(path: Path) -> dict[str, Any]:
    """Return what the record beside a table says of its episodes; nothing if there is none."""
    record = path.with_suffix(".settings.json")
    if not record.exists():
        return {}
    content = read_json(record, _remedy(path))
    said = {name: content.get(name) for name in ("episodes_per_task", "trial_episodes")}
    for name, value in said.items():
        if not isinstance(value, int | None):
            raise RunError(
                f"Expected a whole number or null for `{name}` in `{record}`, got {value!r}; "
                f"{_remedy(path)}."
            )
    return said


def _read_rows(path: Path) -> list[dict[str, float]]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            present = reader.fieldnames or ()
            _check_columns(present, path)
            columns = (*COLUMNS, SOLVED_AT_RESET) if SOLVED_AT_RESET in present else COLUMNS
            return [
                _numbers(row, columns, f"`{path}`, line {reader.line_num}", path) for row in reader
            ]
    except (OSError, UnicodeError, csv.Error) as error:
        raise RunError(f"Expected a table at `{path}`, got {error}; {_remedy(path)}.") from error


def _check_columns(present: Sequence[str], path: Path) -> None:
    missing = [name for name in COLUMNS if name not in present]
    if missing:
        raise RunError(
            f"Expected the column `{missing[0]}` in `{path}`, got "
            f"{', '.join(present) or 'an empty file'}; {_remedy(path)}."
        )


def _numbers(
    row: Mapping[str, str | None], columns: Sequence[str], place: str, path: Path
) -> dict[str, float]:
    return {name: _number(row[name], f"`{name}` in {place}", path) for name in columns}


def _number(text: str | None, what: str, path: Path) -> float:
    try:
        number = float(text or "")
    except ValueError as error:
        raise RunError(
            f"Expected a number for {what}, got {text or 'nothing'}; {_remedy(path)}."
        ) from error
    if not np.isfinite(number):
        raise RunError(
            f"Expected a finite number for {what}, got {text}; the adaptation of this task failed, "
            "see what `maesn adapt` reports."
        )
    return number


def _grid(rows: Sequence[Mapping[str, float]], name: str, first: int, path: Path) -> Curves:
    """Arrange one column as `[task, update]`; tasks count from 0, updates from `first`."""
    cells = {(int(row["task"]), int(row["update"]) - first): row[name] for row in rows}
    num_tasks, num_columns = (1 + max((cell[k] for cell in cells), default=-1) for k in (0, 1))
    if not rows or len(cells) != len(rows) or len(cells) != num_tasks * num_columns:
        raise RunError(
            f"Expected one row for each task and update in `{path}`, tasks 0 to {num_tasks - 1} "
            f"and {num_columns} updates, got {len(rows)} rows; {_remedy(path)}."
        )
    return np.array(
        [[cells[task, update] for update in range(num_columns)] for task in range(num_tasks)]
    )


def _remedy(path: Path) -> str:
    return f"write `{path.name}` again with `maesn adapt`"
