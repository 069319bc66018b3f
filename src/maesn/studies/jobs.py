"""Jobs: the parts of a study that are computed separately, each once.

Each job has a directory in `DIR/jobs`, named by a digest of everything that decides its numbers. It
is done when the directory holds `done.json`, which is written last.
"""

import dataclasses
import statistics
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from maesn import storage
from maesn.evaluation.adapting import as_rows
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.exploration import record_exploration
from maesn.evaluation.running import held_latents
from maesn.learners import AbstractMetaLearner
from maesn.runs.config import CONFIG, RunSettings
from maesn.runs.log import METRICS, TIMING
from maesn.runs.run import Run
from maesn.runs.training import train
from maesn.search.prior import PriorSettings
from maesn.search.stored import bound_to, prior_file, read_prior, run_prior
from maesn.studies.members import RUN, AbstractMember, TrainedRun

DONE, ROWS, LATENTS, EXPLORATION = "done.json", "rows.csv", "latents.npz", "exploration.npz"
# Speed of one thread, on `point` and `wheeled`.
STEPS_PER_SECOND = 50_000


@dataclasses.dataclass(frozen=True)
class Job:
    """A part of a study that is computed separately."""

    name: str  # name of its directory: kind, family, method and seed, and the digest
    needs: tuple[str, ...]  # names of the jobs that must be done before
    steps: int  # approximate number of environment steps, for estimates of time
    compute: Callable[[Path], dict[str, Any]]
    """Writes results into the job's directory, and returns more entries for `done.json`."""
    iterations: int = 0  # meta-iterations of a training
    effort: int | None = None
    """`AbstractMetaLearner.effort` of a training; None for other jobs, of which it is `steps`."""

    @property
    def seconds(self) -> float:
        """A guess of the time that it takes, once it has begun."""
        return (self.steps if self.effort is None else self.effort) / STEPS_PER_SECOND

    def progress(self, directory: Path) -> float:
        """Return the share of a training that is done, from 0 to 1; 0 for other jobs."""
        log = directory / RUN / METRICS
        done = log.read_bytes().count(b"\n") if log.exists() else 0
        return done / max(self.iterations, 1)

    def spent(self, directory: Path) -> tuple[float, float]:
        """Return how much of `seconds` a training has behind it, and how long that took.

        The median meta-iteration counts, once there are three: the first one also compiles. Before,
        and for other jobs, it is 0, 0.
        """
        done = self.progress(directory)
        took = times(directory / RUN) if done * self.iterations > 2 else {}
        if not took:
            return 0.0, 0.0
        return done * self.seconds, done * self.iterations * took["iteration_seconds"]


def computed(job: Job, jobs: Path) -> str | None:
    """Compute a job unless it is done; return its error, None if there is none."""
    directory = jobs / job.name
    try:
        with storage.locked(directory):
            if not (directory / DONE).exists():
                start, left = time.perf_counter(), 1 - job.progress(directory)
                found = job.compute(directory)
                seconds = round(time.perf_counter() - start, 1)
                done = {"steps": round(job.steps * left), "seconds": seconds, **found}
                storage.write_json(directory / DONE, done)
    except (storage.RunError, MemoryError, OSError, RuntimeError) as error:
        return str(error) or repr(error)
    return None


def train_run(
    learner: AbstractMetaLearner[Any, Any], settings: RunSettings, init_from: str, directory: Path
) -> dict[str, Any]:
    """Train a run, from its latest checkpoint if there is one."""
    path = directory / RUN
    if (path / CONFIG).exists():
        run = Run.open(path, settings.own_family, settings.own_method)
    else:
        run = Run.create(path, learner, settings, init_from=init_from or None)
    with closing(train(run)) as iterations:
        for _ in iterations:
            pass
    return {"environment_steps": run.latest().environment_steps, **times(path)}


def times(run: Path) -> dict[str, float]:
    """Return what the training of a run took, and its meta-iterations; nothing if it is pruned."""
    path = run / TIMING
    seconds = [line["seconds"] for line in storage.read_json_lines(path)] if path.exists() else []
    if not seconds:
        return {}
    median = statistics.median(seconds)
    return {"training_seconds": round(sum(seconds), 1), "iteration_seconds": round(median, 4)}


def make_prior(member: TrainedRun, asked: Evaluation, directory: Path) -> dict[str, Any]:
    """Make the prior over returns that a search needs, beside the run's checkpoints."""
    run = member.open(directory.parent)
    env = run.env(asked.reward, asked.sparse_radius)
    path = prior_file(run, env, asked.action_noise)
    wanted = bound_to(run, run.latest_state(), env, asked.action_noise).items()
    if not (path.exists() and wanted <= read_prior(path)[1].items()):
        settings = PriorSettings(action_noise=asked.action_noise)
        run_prior(run, settings, reward=asked.reward, sparse_radius=asked.sparse_radius)
    return {"file": path.name}


def adapt_member(
    member: AbstractMember, asked: Evaluation, tasks: range, directory: Path
) -> dict[str, Any]:
    """Adapt to some tasks; write a row per task and update, and the adapted latents if any."""
    outcome = member.play(asked, tasks, directory.parent)
    rows = ({**row, "task": tasks[row["task"]]} for row in as_rows(outcome))
    storage.write_rows(directory / ROWS, rows)
    latents = held_latents(outcome)
    if latents is not None and not asked.label:  # by the method's own rule
        storage.write_arrays(directory / LATENTS, vars(latents))
    return {}


def record_run(member: TrainedRun, directory: Path) -> dict[str, Any]:
    """Record paths of a run before any adaptation, for figures."""
    record_exploration(member.open(directory.parent), directory / EXPLORATION)
    return {}
