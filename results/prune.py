"""Keep of a directory of studies what their reports and runs need; the rest can be computed again.

    python results/prune.py results

Of a trained run `config.json`, the last checkpoint and the first lines of the metrics stay; a large
checkpoint (RL2's) only of seed 0. To evaluate such a run in another way, remove its job's
directory: the study trains it again. Other jobs go once every study that lists them has their
results in a table. Of a large table, episodes that judge nothing go.
"""

import shutil
from pathlib import Path

import tyro

from maesn.reporting.reading import DEPLOY, read_rows
from maesn.reporting.sources import MANIFEST, joined_files, studies_in
from maesn.runs.config import CONFIG
from maesn.runs.log import METRICS
from maesn.runs.run import CHECKPOINTS
from maesn.runs.sources import TASKS_FILE
from maesn.storage import read_json, write_rows
from maesn.studies.jobs import DONE
from maesn.studies.members import RUN
from maesn.studies.study import JOBS

LINES = 20  # of the metrics
LARGE = 200_000  # bytes of a checkpoint or a table


def prune(directory: tyro.conf.Positional[Path]) -> None:
    """Remove what is not needed from the jobs that are done.

    Args:
        directory: of jobs and results.
    """
    joined: set[str] = set()
    needed: set[str] = set()
    for study in studies_in(directory):
        here = {job for jobs in joined_files(study).values() for job in jobs}
        joined |= here
        needed |= {*read_json(study / MANIFEST)["jobs"]} - here
    for name in joined - needed:
        shutil.rmtree(directory / JOBS / name, ignore_errors=True)
    for done in (directory / JOBS).glob(f"*/{DONE}"):
        if (done.parent / RUN / CONFIG).exists():
            prune_run(done.parent / RUN)
    for table in directory.glob("*/tables/*/*.csv.gz"):
        if table.stat().st_size > LARGE:
            prune_table(table)


def prune_run(run: Path) -> None:
    """Remove all of a run that acting, adapting and comparing do not need."""
    kept = {CONFIG, CHECKPOINTS, METRICS, TASKS_FILE}
    for path in run.iterdir():
        if path.name not in kept:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    seed = read_json(run / CONFIG)["settings"]["seed"]
    checkpoints = sorted((run / CHECKPOINTS).glob("*.safetensors"))
    for checkpoint in checkpoints:
        if checkpoint != checkpoints[-1] or (seed and checkpoint.stat().st_size > LARGE):
            checkpoint.unlink()
    lines = (run / METRICS).read_text().splitlines(keepends=True)
    (run / METRICS).write_text("".join(lines[:LINES]))


def prune_table(path: Path) -> None:
    """Remove the episodes of a search after its first update, where fresh ones judge it."""
    rows = read_rows(path)
    if any(row["purpose"] == DEPLOY for row in rows):
        write_rows(path, (row for row in rows if row["purpose"] == DEPLOY or row["update"] == "0"))


if __name__ == "__main__":
    tyro.cli(prune)
