"""Adapting many methods under the same conditions, each once, however often one is interrupted."""

import dataclasses
import math
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from maesn.envs import AnyEnv, RewardKind, TaskFamily, TaskSet
from maesn.evaluation.evaluate import CHUNK_SIZE, adapt, as_rows, tasks_at_once
from maesn.evaluation.record import Identity, adaptation_record
from maesn.evaluation.tables import adaptation_file, read_rows, record_file, write_rows
from maesn.learners import AbstractFastLearner
from maesn.runs.config import RunSettings, make_env
from maesn.runs.serialization import digest_of_document
from maesn.runs.storage import RunError, explained, read_json, write_json
from maesn.runs.task_sources import find_tasks
from maesn.worlds import AbstractWorld, make_world
from maesn.worlds.collector import Collector

Say: TypeAlias = Callable[[str], None]

RECORD = "settings.json"


@dataclasses.dataclass(frozen=True)
class Conditions:
    """Under which all methods of a comparison are adapted."""

    tasks: str = "test"
    """test (report on these), validation (choose on these), training, ood (unlike all of these), or
    an `.npz` file."""
    num_tasks: int | None = None
    """The first so many tasks of the set; None: all of them."""
    reward: RewardKind = "sparse"
    """Reward in the new tasks."""
    updates: int = 10
    """Updates per task."""
    run_updates: int | None = None
    """Updates per task of trained runs whose policy is not fine-tuned; None: as many as the others.
    Their steps halve, so there is little to see after twenty. Of `rl2` an update is an episode."""
    episodes_per_task: int = 50
    """Episodes per task and update."""
    seed: int = 0
    """Of the episodes of whatever has learned before, of the oracle and of the floor."""
    tasks_at_once: int = CHUNK_SIZE
    """Tasks that advance together. Memory grows with it; what is played does not depend on it."""

    def __post_init__(self) -> None:
        least = {"updates": 0, "episodes_per_task": 1, "tasks_at_once": 1, "seed": 0}
        for name, smallest in least.items():
            if getattr(self, name) < smallest:
                raise ValueError(
                    f"`{name}` must be at least {smallest}, got {getattr(self, name)}."
                )
        if self.seed >= 2**32:
            raise ValueError(f"`seed` must lie between 0 and 2^32 - 1, got {self.seed}.")
        for name, smallest in {"num_tasks": 1, "run_updates": 0}.items():
            value = getattr(self, name)
            if value is not None and value < smallest:
                raise ValueError(f"`{name}` must be at least {smallest}, got {value}.")

    def updates_of_runs(self, *, tuned: bool) -> int:
        """Return the number of updates of trained runs, with fine-tuning or without."""
        return self.updates if tuned or self.run_updates is None else self.run_updates


@dataclasses.dataclass(frozen=True, eq=False)
class ComparisonWorld:
    """Where methods are compared: a world, its tasks, and the conditions."""

    settings: RunSettings
    """Of the environment; what they say of learning means nothing here."""
    env: AnyEnv
    tasks: TaskSet
    world: AbstractWorld
    collect: Collector
    conditions: Conditions

    def close(self) -> None:
        """Stop what plays in the world."""
        self.world.close()

    @property
    def num_tasks(self) -> int:
        """Number of tasks to adapt to."""
        asked = self.conditions.num_tasks
        return len(self.tasks) if asked is None else min(asked, len(self.tasks))

    def record(self, who: Identity, seed: int, updates: int) -> dict[str, Any]:
        """Return what decides the curves of a learner here; see `adaptation_record`."""
        episodes, engine = self.conditions.episodes_per_task, self.settings.engine
        return adaptation_record(who, self.world, engine, episodes, seed, updates)


def open_comparison_world(
    family: TaskFamily, settings: RunSettings, conditions: Conditions
) -> ComparisonWorld:
    """Return a place to compare methods in; its world is to be closed.

    Args:
        family: whose tasks.
        settings: variant, sparse radius, engine and threads.
        conditions: of the comparison.

    Raises:
        RunError: there are no such tasks, or the environment cannot be had like this.
    """
    env, tasks = make_env(family, settings, conditions.reward), find_tasks(conditions.tasks, family)
    try:
        world = make_world(env, tasks, settings.num_threads, settings.engine)
    except ValueError as error:
        raise RunError(str(error)) from error
    collect = Collector(world, conditions.episodes_per_task)
    return ComparisonWorld(settings, env, tasks, world, collect, conditions)


@dataclasses.dataclass(frozen=True, eq=False)
class SeededLearner:
    """A fast learner that takes part, with one seed."""

    name: str
    """Its line in figures and tables; a name for a directory."""
    seed: int
    """Of its meta-training, or of its beginning anew in every task."""
    learner: AbstractFastLearner[Any]
    record: Mapping[str, Any]
    """What decides its curves; see `ComparisonWorld.record`."""
    num_tasks: int
    """It is adapted to the first so many tasks."""
    earlier: Path | None = None
    """Where an earlier adaptation may have left its curves."""


def curves_of(
    contestant: SeededLearner, ground: ComparisonWorld, directory: Path, say: Say
) -> Path:
    """Return the table of a contestant's curves, adapting it unless that has been done.

    Chunk after chunk of the tasks is written down, so that an interrupted adaptation goes on with
    the chunk that was interrupted.

    Args:
        contestant: who.
        ground: where.
        directory: of all curves of the comparison.
        say: is told what goes on.
    """
    if contestant.earlier is not None and _fits(contestant):
        say(f"{contestant.name}, seed {contestant.seed}: found in {contestant.earlier}")
        return contestant.earlier
    place = directory / _unique_name(contestant)
    table = place / adaptation_file(place, ground.conditions.tasks, ground.conditions.reward).name
    if table.exists():
        say(f"{contestant.name}, seed {contestant.seed}: done before")
        return table
    with explained("make", place):
        place.mkdir(parents=True, exist_ok=True)
    write_json(place / RECORD, {**contestant.record, "num_tasks": contestant.num_tasks})
    rows: list[dict[str, Any]] = []
    for tasks in _cut(contestant, ground):
        rows += _adapt_piece(contestant, ground, place, tasks, say)
    write_rows(table, rows)
    shutil.rmtree(place / "pieces")
    return table


def _fits(contestant: SeededLearner) -> bool:
    """Whether an earlier adaptation is the same one, or one that has gone on for longer."""
    assert contestant.earlier is not None
    path = record_file(contestant.earlier)
    if not (path.exists() and contestant.earlier.exists()):
        return False
    found, wanted = read_json(path), dict(contestant.record)
    longer = found.pop("updates", -1) >= wanted.pop("updates")
    return longer and all(found.get(name) == value for name, value in wanted.items())


def _unique_name(contestant: SeededLearner) -> str:
    """Return a name that is another one if anything else decides the curves."""
    decisive = {**contestant.record, "num_tasks": contestant.num_tasks}
    return f"{contestant.name}-seed-{contestant.seed}-{digest_of_document(decisive)}"


def _cut(contestant: SeededLearner, ground: ComparisonWorld) -> list[np.ndarray]:
    """Cut the tasks into chunks of nearly the same size, as large as may be."""
    conditions = ground.conditions
    limit = tasks_at_once(
        ground.world.max_simulations, conditions.episodes_per_task, conditions.tasks_at_once
    )
    count = math.ceil(contestant.num_tasks / limit)
    return np.array_split(np.arange(contestant.num_tasks), count)


def _adapt_piece(
    contestant: SeededLearner, ground: ComparisonWorld, place: Path, tasks: np.ndarray, say: Say
) -> list[dict[str, Any]]:
    """Return the rows of some tasks, playing them unless they were written down before."""
    piece = place / "pieces" / f"tasks-{tasks[0]:03d}-{tasks[-1]:03d}.csv"
    if not piece.exists():
        outcome = adapt(
            contestant.learner,
            ground.collect,
            updates=contestant.record["updates"],
            seed=contestant.record["seed"],
            chunk_size=len(tasks),
            tasks=tasks.tolist(),
        )
        rows = [{**row, "task": int(tasks[int(row["task"])])} for row in as_rows(outcome)]
        write_rows(piece, rows)
        say(
            f"{contestant.name}, seed {contestant.seed}: adapted to tasks {tasks[0]} to "
            f"{tasks[-1]} of {contestant.num_tasks}"
        )
    return read_rows(piece)
