"""Adapting many methods to the same tasks, each once, however often one is interrupted."""

import dataclasses
import math
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from maesn.evaluation.evaluate import adapt, as_rows
from maesn.evaluation.tables import adaptation_file, write_rows
from maesn.learners import AbstractFastLearner
from maesn.report.reading import RECORD, read_rows
from maesn.runs.serialization import digest_of_document
from maesn.storage import explained, read_json, write_json
from maesn.studies.world import ComparisonWorld

Say: TypeAlias = Callable[[str], None]


@dataclasses.dataclass(frozen=True, eq=False)
class SeededLearner:
    """A fast learner that is compared, with one seed."""

    name: str
    """Its line in figures and tables; a name for a directory."""
    seed: int
    """Of its meta-training, or of its beginning anew in every task."""
    learner: AbstractFastLearner[Any]
    record: Mapping[str, Any]
    """What decides its curves; see `ComparisonWorld.record`."""
    earlier: Path | None = None
    """Where an earlier adaptation may have left its curves."""

    @property
    def num_tasks(self) -> int:
        """It is adapted to the first so many tasks."""
        return int(self.record["num_tasks"])


def curves_of(one: SeededLearner, world: ComparisonWorld, directory: Path, say: Say) -> Path:
    """Return the table of a learner's curves, adapting it unless that has been done.

    Chunk after chunk of the tasks is written down, so that an interrupted adaptation goes on with
    the chunk that was interrupted.
    """
    if one.earlier is not None and _fits(one.record, one.earlier):
        say(f"{one.name}, seed {one.seed}: found in {one.earlier}")
        return one.earlier
    # The name is another one if anything else decides the curves.
    folder = directory / f"{one.name}-seed-{one.seed}-{digest_of_document(one.record)}"
    table = folder / adaptation_file(folder, world.evaluation).name
    if table.exists():
        say(f"{one.name}, seed {one.seed}: done before")
        return table
    with explained("make", folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "settings.json", dict(one.record))
    rows: list[dict[str, Any]] = []
    for tasks in _cut(one, world):
        rows += _adapt_piece(one, world, folder, tasks, say)
    write_rows(table, rows)
    shutil.rmtree(folder / "pieces")
    return table


def _fits(record: Mapping[str, Any], earlier: Path) -> bool:
    """Whether an earlier adaptation is the same one, or one of more tasks or episodes."""
    path = earlier.with_suffix(RECORD)
    if not (path.exists() and earlier.exists()):
        return False
    found, wanted = read_json(path), dict(record)
    enough = all(found.pop(name, -1) >= wanted.pop(name) for name in ("num_tasks", "episodes"))
    return enough and all(found.get(name) == value for name, value in wanted.items())


def _cut(one: SeededLearner, world: ComparisonWorld) -> list[np.ndarray]:
    """Cut the tasks into chunks of nearly the same size, as large as may be."""
    limits = [plays.most_tasks for plays in (world.collect, world.deploy) if plays is not None]
    count = math.ceil(one.num_tasks / min(world.evaluation.tasks_at_once, *limits))
    return np.array_split(np.arange(one.num_tasks), count)


def _adapt_piece(
    one: SeededLearner, world: ComparisonWorld, folder: Path, tasks: np.ndarray, say: Say
) -> list[dict[str, Any]]:
    """Return the rows of some tasks, playing them unless they were written down before."""
    piece = folder / "pieces" / f"tasks-{tasks[0]:03d}-{tasks[-1]:03d}.csv"
    if not piece.exists():
        outcome = adapt(
            one.learner,
            world.collect,
            episodes=one.record["episodes"],
            deploy=world.deploy,
            seed=one.record["seed"],
            chunk_size=len(tasks),
            tasks=tasks.tolist(),
        )
        rows = [{**row, "task": int(tasks[int(row["task"])])} for row in as_rows(outcome)]
        write_rows(piece, rows)
        say(
            f"{one.name}, seed {one.seed}: adapted to tasks {tasks[0]} to "
            f"{tasks[-1]} of {one.num_tasks}"
        )
    return read_rows(piece)
