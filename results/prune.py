"""Keep of a directory of studies what their reports and runs need; the rest can be computed again.

    python results/prune.py results

Of a trained run `config.json` and the first lines of the metrics stay; the last checkpoint only
while a study still has to evaluate it. To evaluate a run without one, remove its job's directory:
the study trains it again. Other jobs go once every study that lists them has their results in a
table. Of tables, episodes that judge nothing go, and after update 20 four updates of five; of
latents, those that no figure shows; of tables and recorded arrays, digits that no figure and no
printed number shows, and half of the points of recorded paths.
"""

import shutil
from pathlib import Path

import numpy as np
import tyro

from maesn.reporting.reading import DEPLOY, LATENTS, MEASURES, latents_beside
from maesn.reporting.sources import MANIFEST, joined_files, studies_in
from maesn.runs.checkpoint import REPLAY
from maesn.runs.config import CONFIG
from maesn.runs.log import METRICS
from maesn.runs.run import CHECKPOINTS
from maesn.runs.sources import TASKS_FILE
from maesn.storage import RunError, read_arrays, read_json, read_rows, write_rows
from maesn.studies.jobs import DONE
from maesn.studies.members import RUN
from maesn.studies.study import JOBS, Study

LINES = 20  # of the metrics
PATH_POINTS = 101  # of a recorded path, at most
ALL_UPDATES, STRIDE = 20, 5  # of a table: every update up to this one, then every fifth


def prune(directory: tyro.conf.Positional[Path]) -> None:
    """Remove what is not needed from the jobs that are done.

    Args:
        directory: of jobs and results.
    """
    jobs = directory / JOBS
    joined: set[str] = set()
    left: set[str] = set()
    needed: set[str] = set()
    # A study whose file is here may have computed nothing yet.
    planned = (file.with_suffix("") for file in directory.glob("*.toml"))
    for path in {*studies_in(directory), *planned}:
        here = {job for names in joined_files(path).values() for job in names}
        listed, missing = jobs_of(path)
        joined |= here
        left |= listed - here
        needed |= missing
    for name in joined - left:
        shutil.rmtree(jobs / name, ignore_errors=True)
    for done in jobs.glob(f"*/{DONE}"):
        if (done.parent / RUN / CONFIG).exists():
            prune_run(done.parent / RUN, done.parent.name in needed)
    for table in directory.glob("*/tables/*/*.csv.gz"):
        prune_table(table)
    for path in studies_in(directory):
        prune_latents(path)
    for pattern in ("*/tables/*/*.npz", "*/recorded/*/*.npz"):
        for arrays in directory.glob(pattern):
            prune_arrays(arrays)


def jobs_of(path: Path) -> tuple[set[str], set[str]]:
    """Return the jobs of a study, and those whose results it still needs to compute others."""
    source = path.with_suffix(".toml")
    try:
        study = Study.load(source if source.exists() else path.name)
    except RunError:  # its file is elsewhere, so all of them may be needed
        if not (path / MANIFEST).exists():
            raise
        listed = {*read_json(path / MANIFEST)["jobs"]}
        return listed, listed
    execution = study.execution(path.parent)
    undone = (job for job in study.jobs.values() if not execution.is_done(job.name))
    return {*study.jobs}, {name for job in undone for name in job.needs}


def prune_run(run: Path, needed: bool) -> None:
    """Keep settings, the first lines of the metrics and, if needed, the last checkpoint.

    No evaluation needs a replay.
    """
    kept = {CONFIG, CHECKPOINTS, METRICS, TASKS_FILE}
    for path in run.iterdir():
        if path.name not in kept:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    for replay in (run / CHECKPOINTS).glob(f"{REPLAY}*"):
        replay.unlink()
    checkpoints = sorted((run / CHECKPOINTS).glob("*.safetensors"))
    for checkpoint in checkpoints[: -1 if needed else None]:
        checkpoint.unlink()
    lines = (run / METRICS).read_text().splitlines(keepends=True)
    (run / METRICS).write_text("".join(lines[:LINES]))


def prune_table(path: Path) -> None:
    """Round the measures, thin out long curves, and keep only the episodes that judge something.

    Of a search these are the first ones and those played for judging alone.
    """
    rows = read_rows(path)
    last = max(int(row["update"]) for row in rows)
    rows = [row for row in rows if _is_kept(int(row["update"]), last)]
    if any(row["purpose"] == DEPLOY for row in rows):
        rows = [row for row in rows if row["purpose"] == DEPLOY or row["update"] == "0"]
    for row in rows:
        for name in MEASURES:
            digits = 2 if name.endswith("return") else 4
            row[name] = repr(round(float(row[name]), digits))
    write_rows(path, rows)


def _is_kept(update: int, last: int) -> bool:
    return update <= ALL_UPDATES or update % STRIDE == 0 or update == last


def prune_latents(study: Path) -> None:
    """Remove adapted latents that no figure shows. Figures show those of a line's first seed."""
    document = read_json(study / MANIFEST)
    drawn = [figure["families"] for figure in document["figures"] if figure["kind"] == "latents"]
    for world in document["comparisons"]:
        shown = any(not families or world["family"] in families for families in drawn)
        tables = (study / line["seeds"][0]["table"] for line in world["lines"] if shown)
        kept = set(map(latents_beside, tables))
        for path in (study / "tables" / world["name"]).glob(f"*{LATENTS}"):
            if path not in kept:
                path.unlink()


def prune_arrays(path: Path) -> None:
    """Round positions (to millimetres), latents and rates; keep every second point of a path."""
    arrays = read_arrays(path, "restore it")
    for name, array in arrays.items():
        long = name.endswith("paths") and array.shape[1] > PATH_POINTS
        kept = array[:, ::2] if long else array
        arrays[name] = kept.round(3) if kept.dtype.kind == "f" else kept
    np.savez_compressed(path, **arrays)


if __name__ == "__main__":
    tyro.cli(prune)
