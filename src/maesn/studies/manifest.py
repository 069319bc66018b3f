"""What a study leaves for its report: tables of what is done, and the manifest that names them."""

import dataclasses
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from maesn import storage
from maesn.reporting.reading import latents_beside
from maesn.reporting.sources import MANIFEST
from maesn.runs.config import installed_versions
from maesn.studies.execution import Execution
from maesn.studies.jobs import EXPLORATION, LATENTS, ROWS, times
from maesn.studies.members import RUN
from maesn.studies.planned import PlannedComparison, PlannedLine
from maesn.studies.spec import StudySpec


def files_of(comparisons: Sequence[PlannedComparison]) -> dict[str, Sequence[str]]:
    """Return each file that the report reads, with the jobs whose results it joins."""
    files: dict[str, Sequence[str]] = {}
    for one in comparisons:
        files |= {_recorded(one.name, source): [job] for source, job in one.recorded.items()}
        for line in chain(*one.lines.values()):
            files |= {_table(one.name, line, member.seed): parts for member, parts in line.seeds}
    return files


def write_manifest(
    spec: StudySpec,
    comparisons: Sequence[PlannedComparison],
    execution: Execution,
    directory: Path,
) -> None:
    """Write the tables of what is done, and the manifest."""
    files = files_of(comparisons)
    document = {
        "study": spec.name,
        "comparisons": [_collect(one, execution, directory) for one in comparisons],
        "figures": [dataclasses.asdict(one) for one in spec.figures],
        "jobs": sorted(execution.jobs),
        "files": {x: jobs for x, jobs in files.items() if all(map(execution.is_done, jobs))},
        "versions": installed_versions("mujoco.batch"),
    }
    storage.write_json(directory / MANIFEST, document)


def _collect(
    comparison: PlannedComparison, execution: Execution, directory: Path
) -> dict[str, Any]:
    """Write the tables of a comparison; return it with those lines and seeds that are done.

    If a study was pruned the files of its jobs are gone: its tables stay as they are.
    """
    name, recorded = comparison.name, {}
    for source, job in comparison.recorded.items():
        if execution.is_done(job):
            recorded[source] = _recorded(name, source)
            if (path := execution.directory / job / EXPLORATION).exists():
                storage.write_whole(directory / recorded[source], path.read_bytes())
    groups = {}
    for group, lines in comparison.lines.items():
        found = [(line, _seeds(line, name, execution, directory)) for line in lines]
        groups[group] = [line.document(seeds) for line, seeds in found if seeds]
    return {"name": name, **comparison.world, **groups, "recorded": recorded}


def _seeds(
    line: PlannedLine, comparison: str, execution: Execution, directory: Path
) -> list[dict[str, Any]]:
    """Return the seeds of a line that are done, each with a table of all its tasks."""
    seeds = []
    for member, parts in line.seeds:
        trained = [execution.done(job) or {} for job in member.needs]
        if all(trained) and all(map(execution.is_done, parts)):
            table = _table(comparison, line, member.seed)
            _join([execution.directory / job for job in parts], directory / table)
            steps = trained[0]["environment_steps"] if trained else member.training_steps
            seeds.append({"seed": member.seed, "table": table, "training_steps": steps})
            if trained:
                found = times(execution.directory / member.needs[0] / RUN) or trained[0]
                seeds[-1] |= {name: x for name, x in found.items() if name.endswith("_seconds")}
    return seeds


def _join(jobs: Sequence[Path], table: Path) -> None:
    """Write a table of all tasks; beside it the adapted latents, where jobs have kept them."""
    if not all((job / ROWS).exists() for job in jobs):
        return
    storage.write_rows(table, [row for job in jobs for row in storage.read_rows(job / ROWS)])
    latents = latents_beside(table)
    if all((job / LATENTS).exists() for job in jobs):
        parts = [storage.read_arrays(job / LATENTS, "compute it again") for job in jobs]
        joined = {x: np.concatenate([part[x] for part in parts]) for x in ("mean", "log_std")}
        storage.write_arrays(latents, parts[0] | joined)
    else:
        latents.unlink(missing_ok=True)  # what the line had before its evaluation was changed


def _table(comparison: str, line: PlannedLine, seed: int) -> str:
    return f"tables/{comparison}/{line.name}-seed-{seed}.csv.gz"


def _recorded(comparison: str, source: str) -> str:
    return f"recorded/{comparison}/{source}.npz"
