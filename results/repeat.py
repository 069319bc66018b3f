"""Train a run of a study again, and compare the first lines of its metrics, digit by digit.

    python results/repeat.py results/jobs/train-wheeled-maesn-seed-0-5dc048f6e6d0a961

Processors round differently: only on the machine that trained the run are the lines the same. A
run that started from another one cannot be repeated like this.
"""

import os
import tempfile
from contextlib import closing
from itertools import islice
from pathlib import Path

import tyro

from maesn.runs.log import METRICS
from maesn.runs.run import Run
from maesn.runs.training import train
from maesn.studies.executors import thread_variables
from maesn.studies.members import RUN


def repeat(job: tyro.conf.Positional[Path], iterations: int = 20) -> None:
    """Train again for some iterations; the exit status says whether the metrics are the same."""
    first = Run.open(job / RUN)
    kept = (first.directory / METRICS).read_bytes().splitlines()[:iterations]
    with tempfile.TemporaryDirectory() as directory:
        again = Run.create(Path(directory) / RUN, first.learner, first.settings)
        with closing(train(again)) as trained:
            list(islice(trained, iterations))
        played = (again.directory / METRICS).read_bytes().splitlines()
    same = sum(map(bytes.__eq__, kept, played))
    print(f"{job.name}: {same} of {len(kept)} lines are the same")
    raise SystemExit(0 if same == len(kept) else 1)


if __name__ == "__main__":
    # Before JAX starts its threads: sums depend on their number.
    os.environ.update(thread_variables(1))
    tyro.cli(repeat)
