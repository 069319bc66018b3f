"""Keep of a study's directory what its report and its runs need; the rest can be computed again.

    python results/prune.py results

Of a trained run `config.json`, the last checkpoint and the first lines of the metrics stay; of
all other jobs that are done, a line in one file. A search makes the prior of a run again, in
seconds.
"""

import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

import tyro

from maesn.runs.config import CONFIG
from maesn.runs.log import METRICS
from maesn.runs.run import CHECKPOINTS
from maesn.runs.sources import TASKS_FILE
from maesn.storage import read_json, write_json
from maesn.studies.execution import FINISHED
from maesn.studies.jobs import DONE
from maesn.studies.members import RUN
from maesn.studies.study import JOBS, Study

LINES = 20  # of the metrics


def prune(directory: tyro.conf.Positional[Path], studies: Sequence[str] = ("paper",)) -> None:
    """Remove what is not needed from the jobs that are done.

    Args:
        directory: of jobs and results.
        studies: those that go on there; what they still need for their tables stays.
    """
    path = directory / JOBS / FINISHED
    finished = read_json(path) if path.exists() else {}
    waiting = {job for name in studies for job in _unjoined(Study.load(name), directory)}
    for done in sorted((directory / JOBS).glob(f"*/{DONE}")):
        job = done.parent
        if (job / RUN / CONFIG).exists():
            prune_run(job / RUN)
        elif job.name not in waiting:
            finished[job.name] = read_json(done)
    write_json(path, dict(sorted(finished.items())))
    for name in finished:
        if name not in waiting:
            shutil.rmtree(directory / JOBS / name, ignore_errors=True)


def _unjoined(study: Study, directory: Path) -> Iterator[str]:
    """Yield the jobs of tables that are not there, or of which a part is still to be computed."""
    execution = study.execution(directory)
    for path, parts in study.files(directory):
        if not path.exists() or not all(map(execution.is_done, parts)):
            yield from parts


def prune_run(run: Path) -> None:
    """Remove all of a run that acting, adapting and comparing do not need."""
    kept = {CONFIG, CHECKPOINTS, METRICS, TASKS_FILE}
    for path in run.iterdir():
        if path.name not in kept:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    for checkpoint in sorted((run / CHECKPOINTS).glob("*.safetensors"))[:-1]:
        checkpoint.unlink()
    lines = (run / METRICS).read_text().splitlines(keepends=True)
    (run / METRICS).write_text("".join(lines[:LINES]))


if __name__ == "__main__":
    tyro.cli(prune)
