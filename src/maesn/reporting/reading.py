"""The tables that adaptations leave: their names, and the curves in them."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, SupportsInt

import numpy as np
from jaxtyping import Bool, Float, Int

from maesn.reporting.runs import RECORDED_TASKS
from maesn.storage import RunError, read_json, read_rows

# TASKS-REWARD, and behind it rule and budget where they are not the usual ones, as in
# `-search-300275-with-10-episodes`.
_NUMBERS = r"(?:-\d+-(?:episodes|per-update|deployed)|-after(?:-\d+)+|-seed-\d+|-action-noise)+"
_NAME = re.compile(rf"(.+)-(dense|sparse)(-.+?)??(-with{_NUMBERS})?")

# Beside a table, of the same stem: the adapted latents, and how both were made.
LATENTS, RECORD = ".latents.npz", ".settings.json"

_REMEDY = "write it again with `maesn adapt`"


class TableName(NamedTuple):
    """The parts of a table's name."""

    # The task set; behind it number of tasks and radius where they are not the usual ones.
    tasks: str
    reward: str  # empty if the file has another kind of name
    rule: str = ""  # rule, wrappers and digest, after a hyphen; empty for the method as it is
    budget: str = ""  # budgets, seed and noise, as in `-with-10-episodes`; empty for the usual ones

    @classmethod
    def of(cls, table: Path) -> "TableName":
        """Return the name of a file."""
        found = _NAME.fullmatch(table.stem)
        return cls(table.stem, "") if found is None else cls(*found.groups(default=""))

    def path(self, run: Path) -> Path:
        """Return where such a table of a run goes by default."""
        name = f"{self.tasks}-{self.reward}{self.rule}{self.budget}.csv"
        return run / "adaptation" / name

    @property
    def label(self) -> str:
        """Rule and budget in words, for figures; empty for the usual ones."""
        return " ".join([*self.rule.split("-")[1:-1], *self.budget.split("-")[1:]])


def tables_of(run: Path) -> dict[TableName, Path]:
    """Return the tables in a run directory, those with the shortest names first."""
    files = sorted((run / "adaptation").glob("*.csv"))
    named = {TableName.of(file): file for file in files}
    return {name: named[name] for name in sorted(named) if name.reward}


def usual_table(run: Path) -> Path | None:
    """Return the table of the test tasks on sparse reward by the method's own rule, if any."""
    tables = tables_of(run).items()
    found = (path for name, path in tables if name[:3] == (RECORDED_TASKS, "sparse", ""))
    return next(found, None)


def latents_beside(table: Path) -> Path:
    """Return where the adapted latents of a table are."""
    return table.with_name(table.name.removesuffix(".gz")).with_suffix(LATENTS)


Curves = Float[np.ndarray, "*seed task update"]

MEASURES = ("mean_return", "goal_return", "success_rate", "final_success_rate", "time_in_region")
_OF_SUCCESS = MEASURES[2:]  # NaN where the family defines no success
COLUMNS = ("task", "update", "episodes", "purpose", *MEASURES, "solved_at_reset")

# The purposes of episodes: a row judges those of one.
EXPLORE, DEPLOY = "explore", "deploy"


def prior_reach(
    success_rate: Float[np.ndarray, " task"], solved: Bool[np.ndarray, " task"], episodes: int
) -> str:
    """Say how many goals a policy reaches before it learns, of those not reached at reset."""
    if solved.all() or np.isnan(success_rate).all():
        return ""
    share = (success_rate[~solved] > 0).mean()
    return f"{share:.0%} of the goals in {count_of(episodes)}"


def count_of(episodes: SupportsInt) -> str:
    """Return a number of episodes in words."""
    return "1 episode" if int(episodes) == 1 else f"{episodes} episodes"


@dataclass(frozen=True)
class AdaptationTable:
    """An adaptation's curves; `stack_seeds` adds their axis of seeds.

    Measures are those of the deployed agent where the file has them, else those of the episodes
    that were learned from.
    """

    tasks: str  # name of the task set
    reward: str
    purpose: str  # of the episodes that are judged: `EXPLORE` or `DEPLOY`
    # Updates that lie before each column, and the episodes per task that they have learned from.
    updates: Int[np.ndarray, " update"]
    episodes: Int[np.ndarray, " update"]
    mean_return: Curves
    goal_return: Curves
    success_rate: Curves
    final_success_rate: Curves
    time_in_region: Curves
    solved_at_reset: Curves
    # `success_rate` of the episodes that were learned from, after every update; of those that judge
    # where nothing is learned.
    explored_success_rate: Float[np.ndarray, "*seed task explored"]
    # Episodes of a trial that meta-training has prepared for; None if no record says so.
    trial_episodes: int | None = None
    about: Mapping[str, Any] = field(default_factory=dict)  # the record, if there is one

    @property
    def num_tasks(self) -> int:
        """Number of tasks."""
        return int(self.mean_return.shape[-2])

    @property
    def episodes_per_update(self) -> int | None:
        """Episodes per task between the first two columns; None if the table has a single one."""
        return int(self.episodes[1] - self.episodes[0]) if len(self.episodes) > 1 else None

    @property
    def first_beyond(self) -> int | None:
        """First column that lies beyond what meta-training has prepared for; None without one."""
        if self.trial_episodes is None or self.episodes[-1] < self.trial_episodes:
            return None
        return int(np.searchsorted(self.episodes, self.trial_episodes))

    @property
    def is_solved_at_reset(self) -> Bool[np.ndarray, " task"]:
        """Whether some episode of a task starts in its goal region."""
        solved = (self.solved_at_reset > 0).any(axis=-1)
        return np.asarray(solved.reshape(-1, self.num_tasks).any(axis=0))

    @property
    def prior_reach(self) -> str:
        """The share of goals that the first seed reaches from the prior; empty if unknown."""
        episodes = self.about.get("episodes_per_update", self.episodes_per_update)
        if episodes is None:
            return ""
        of_seeds = self.explored_success_rate[..., 0].reshape(-1, self.num_tasks)
        return prior_reach(of_seeds[0], self.is_solved_at_reset, episodes)

    @property
    def curves(self) -> dict[str, Any]:
        """All curves by name."""
        return {name: x for name, x in vars(self).items() if np.ndim(x) > 1}

    def part(self, tasks: Bool[np.ndarray, " task"]) -> "AdaptationTable":
        """Return the table of some of the tasks."""
        return replace(self, **{name: x[..., tasks, :] for name, x in self.curves.items()})


def stack_seeds(tables: Sequence[AdaptationTable]) -> AdaptationTable:
    """Return the table of all seeds, `[seed, task, update]`; `RunError` if they differ in size."""
    extents = sorted({(t.num_tasks, int(t.updates[0]), int(t.updates[-1])) for t in tables})
    if len(extents) > 1:
        found = " and ".join("{} tasks, updates {} to {}".format(*extent) for extent in extents)
        raise RunError(
            f"Expected every seed to be adapted alike, got {found} ({tables[0].tasks} tasks); "
            "run `maesn adapt` with the same `--tasks` and `--episodes` for each."
        )
    stacked: Any = {name: np.stack([t.curves[name] for t in tables]) for name in tables[0].curves}
    return replace(tables[0], **stacked)


def read_adaptation(path: Path, about: Mapping[str, Any] | None = None) -> AdaptationTable:
    """Read a table of `maesn adapt`; a `RunError` if it is damaged.

    `about` is its record. None: the one beside it, if there is one.
    """
    rows, record = read_rows(path, _REMEDY), path.with_suffix(RECORD)
    if about is None:
        about = read_json(record, _REMEDY) if record.exists() else {}
    try:
        purposes = {row["purpose"] for row in rows}
        purpose = DEPLOY if DEPLOY in purposes else EXPLORE
        first = EXPLORE if EXPLORE in purposes else purpose  # where nothing is learned
        if about and first != EXPLORE:
            about = {**about, "episodes_per_update": about["deploy_episodes"]}
        explored, judged = (_grids(rows, one) for one in (first, purpose))
    except (KeyError, TypeError, ValueError) as error:
        raise RunError(f"`{path}` cannot be drawn: {error}; {_REMEDY}.") from error
    name = TableName.of(path)
    return AdaptationTable(
        tasks=name.tasks,
        reward=name.reward,
        purpose=purpose,
        updates=judged["update"][0].astype(int),
        episodes=judged["episodes"][0].astype(int),
        **{measure: judged[measure] for measure in (*MEASURES, "solved_at_reset")},
        explored_success_rate=explored["success_rate"],
        trial_episodes=about.get("trial_episodes"),
        about=about,
    )


def _grids(rows: Sequence[Mapping[str, Any]], purpose: str) -> dict[str, Curves]:
    """Arrange the numbers of one purpose as `[task, update]`."""
    chosen = [row for row in rows if row["purpose"] == purpose]
    numbers = [name for name in COLUMNS if name != "purpose"]
    columns = {name: np.array([row[name] for row in chosen], float) for name in numbers}
    tasks, updates = (np.unique(columns[name]) for name in ("task", "update"))
    pairs = set(zip(columns["task"], columns["update"], strict=True))
    if not len(chosen) == len(pairs) == len(tasks) * len(updates) > 0:
        raise ValueError(f"its rows of purpose {purpose} lack a task or an update, or repeat one")
    for name, column in columns.items():
        is_missing = name in _OF_SUCCESS and np.isnan(column).all()
        if not (is_missing or np.isfinite(column).all()):
            raise ValueError("a number in it is not finite, the adaptation failed")
    order = np.lexsort((columns["update"], columns["task"]))
    return {name: column[order].reshape(len(tasks), -1) for name, column in columns.items()}
