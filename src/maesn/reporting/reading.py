"""The tables that adaptations leave: their names, and the curves in them."""

import csv
import gzip
import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from maesn.runtime import archive
from maesn.storage import RunError, read_json

# TASKS-REWARD, and behind it the rule, as in `-then-trpo`, if it is not the method's own.
_NAME = re.compile(r"(?P<tasks>.+)-(?P<reward>dense|sparse)(?P<changed>-.+)?")

# Beside a table, of the same stem: the adapted latents, and how both were made.
LATENTS, RECORD = ".latents.npz", ".settings.json"


class TableName(NamedTuple):
    """What the name of a table says."""

    tasks: str
    """Name of the task set; before it `from-UPDATE-` if an earlier adaptation went on, behind it
    radius, engine and number of tasks where they are not the usual ones."""
    reward: str
    """Reward of the adaptation; empty if the file is called otherwise."""
    changed: str = ""
    """Rule and wrappers, with a hyphen before them; empty for the method as it is."""

    def path(self, directory: Path) -> Path:
        """Return where such a table of a run goes by default."""
        return directory / "adaptation" / f"{self.tasks}-{self.reward}{self.changed}.csv"


def table_name(path: Path) -> TableName:
    """Return what the name of a table says."""
    found = _NAME.fullmatch(path.stem)
    return TableName(path.stem, "") if found is None else TableName(*found.groups(default=""))


def latents_beside(table: Path) -> Path:
    """Return where the adapted latents of a table are."""
    return table.with_name(table.name.removesuffix(".gz")).with_suffix(LATENTS)


def remedy(path: Path) -> str:
    """Return what to do about a broken file of an adaptation."""
    return f"write `{path.name}` again with `maesn adapt`"


def read_rows(
    path: Path, columns: Iterable[str] = (), remedy: str = "restore it"
) -> list[dict[str, Any]]:
    """Return the rows of a `.csv` or `.csv.gz` file as texts; `RunError` if a column is missing."""
    try:
        archive.refuse_special(path)
        opened = gzip.open if path.suffix == ".gz" else open
        with opened(path, "rt", newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            rows, present = list(reader), reader.fieldnames or ()
    except (OSError, EOFError, ValueError, csv.Error, zlib.error) as error:
        raise RunError(f"Expected a table at `{path}`, got {error}; {remedy}.") from error
    for name in columns:
        if name not in present:
            found = ", ".join(present) or "an empty file"
            raise RunError(f"Expected the column `{name}` in `{path}`, got {found}; {remedy}.")
    return rows


Curves = Float[np.ndarray, "*seed task update"]

MEASURES = ("mean_return", "goal_return", "success_rate", "final_success_rate", "time_in_region")
COLUMNS = ("task", "update", "episodes", "purpose", *MEASURES, "solved_at_reset")

# Which episodes a row judges.
EXPLORE, DEPLOY = "explore", "deploy"


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
    """An `adaptation/<tasks>-<reward>.csv`: curves `[i, k]` of task i in column k.

    `stack_seeds` adds an axis of seeds to the curves. The measures (see `AdaptationCurves`) are
    those of the deployed agent where the file has them, else those of the episodes that were
    learned from.
    """

    tasks: str
    """Name of the task set."""
    reward: str
    purpose: str
    """What the measures judge: `EXPLORE` or `DEPLOY`."""
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
    explored_success_rate: Float[np.ndarray, "*seed task explored"]
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
        return int(self.mean_return.shape[-2])

    @property
    def episodes_per_update(self) -> int | None:
        """Episodes per task that each update learns from; None if the table has a single column."""
        return int(self.episodes[1] - self.episodes[0]) if len(self.episodes) > 1 else None

    @property
    def first_beyond(self) -> int | None:
        """First column that lies beyond what meta-training has prepared for; None without one."""
        if self.trial_episodes is None or self.episodes[-1] < self.trial_episodes:
            return None
        return int(np.searchsorted(self.episodes, self.trial_episodes))

    @property
    def is_solved_at_reset(self) -> Bool[np.ndarray, " task"]:
        """Which tasks some episode starts in the goal region of."""
        by_task = np.moveaxis(self.solved_at_reset, -2, 0).reshape(self.num_tasks, -1)
        return np.asarray((by_task > 0).any(axis=1))

    @property
    def prior_reach(self) -> PriorReach | None:
        """What the prior of a run, the first seed, reaches; None if the table does not tell."""
        episodes = self.explored_episodes or self.episodes_per_update
        if self.updates[0] or episodes is None:
            return None
        of_seeds = self.explored_success_rate[..., 0].reshape(-1, self.num_tasks)
        return prior_reach(of_seeds[0], self.is_solved_at_reset, episodes)

    def part(
        self, tasks: slice | Bool[np.ndarray, " task"], columns: slice = slice(None)
    ) -> "AdaptationTable":
        """Return the table of some of the tasks and updates."""
        changed: dict[str, Any] = {
            name: x[..., tasks, :][..., columns] if x.ndim > 1 else x[columns]
            for name, x in vars(self).items()
            if isinstance(x, np.ndarray)
        }
        return replace(self, **changed)


def stack_seeds(tables: Sequence[AdaptationTable]) -> AdaptationTable:
    """Return the table of all seeds of a method, with axes `[seed, task, update]`.

    A `RunError` says if they were not adapted alike.
    """
    extents = sorted({(t.num_tasks, int(t.updates[0]), int(t.updates[-1])) for t in tables})
    if len(extents) > 1:
        found = " and ".join("{} tasks, updates {} to {}".format(*extent) for extent in extents)
        raise RunError(
            f"Expected every seed to be adapted alike, got {found} ({tables[0].tasks} tasks); "
            "run `maesn adapt` with the same `--tasks` and `--episodes` for each."
        )
    curves = [name for name, x in vars(tables[0]).items() if np.ndim(x) > 1]
    stacked: dict[str, Any] = {
        name: np.stack([vars(table)[name] for table in tables]) for name in curves
    }
    return replace(tables[0], **stacked)


def read_adaptation(path: Path) -> AdaptationTable:
    """Read a table of `maesn adapt`, rows in any order, and its record where there is one.

    A file that is missing, damaged or lacks a row is a `RunError`.
    """
    rows = read_rows(path, COLUMNS, remedy(path))
    purposes = {row["purpose"] for row in rows}
    purpose = DEPLOY if DEPLOY in purposes else EXPLORE
    try:
        explored, judged = (_grids(rows, one) for one in (EXPLORE, purpose))
        if len(judged["task"]) != len(explored["task"]):
            raise ValueError("the tasks of its two purposes differ")
    except ValueError as error:
        raise RunError(f"`{path}` cannot be drawn: {error}; {remedy(path)}.") from error
    name, (explored_episodes, trial_episodes, rule) = table_name(path), _record(path)
    return AdaptationTable(
        tasks=name.tasks,
        reward=name.reward,
        purpose=purpose,
        updates=judged["update"][0].astype(int),
        episodes=judged["episodes"][0].astype(int),
        **{measure: judged[measure] for measure in (*MEASURES, "solved_at_reset")},
        explored_success_rate=explored["success_rate"],
        explored_episodes=explored_episodes,
        trial_episodes=trial_episodes,
        rule=rule,
    )


def _record(path: Path) -> tuple[int | None, int | None, str]:
    """Return episodes per update, trial length and rule from the record beside a table, if any."""
    record = path.with_suffix(RECORD)
    found = read_json(record, remedy(path)) if record.exists() else {}
    counts = found.get("episodes_per_update"), found.get("trial_episodes")
    label = found.get("label", "")
    if not (all(isinstance(one, int | None) for one in counts) and isinstance(label, str)):
        raise RunError(f"`{record}` is not what `maesn adapt` writes; {remedy(path)}.")
    return *counts, label


def _grids(rows: Sequence[Mapping[str, Any]], purpose: str) -> dict[str, Curves]:
    """Arrange the numbers of one purpose as `[task, update]`; tasks count from 0."""
    chosen = [row for row in rows if row["purpose"] == purpose]
    columns = {
        name: np.array([row[name] or "nothing" for row in chosen]).astype(np.float64)
        for name in COLUMNS
        if name != "purpose"
    }
    for name, column in columns.items():
        if not np.isfinite(column).all():
            raise ValueError(
                f"a number in its column `{name}` is not finite, the adaptation failed"
            )
    order = np.lexsort((columns["update"], columns["task"]))
    num_tasks, updates = len(np.unique(columns["task"])), np.unique(columns["update"])
    indices = np.meshgrid(np.arange(num_tasks), updates, indexing="ij")
    found = [columns[name][order] for name in ("task", "update")]
    # A deployed agent need not be judged after every update.
    is_whole = purpose == DEPLOY or (np.diff(updates) == 1).all()
    if not (num_tasks and is_whole and np.array_equal(found, np.reshape(indices, (2, -1)))):
        raise ValueError(f"its rows of purpose {purpose} lack a task or an update, or repeat one")
    grids = {name: column[order].reshape(num_tasks, -1) for name, column in columns.items()}
    if np.ptp(grids["episodes"], axis=0).any():
        raise ValueError("tasks differ in their numbers of episodes")
    return grids
