"""Jobs: the parts of a study that are computed separately, each once.

A job is a directory in `DIR/jobs`, named by a digest of all that decides its numbers. It is done
when `done.json` stands in it, which is written last.
"""

import dataclasses
import time
from abc import ABC, abstractmethod
from contextlib import closing
from pathlib import Path
from typing import Any

from maesn.envs import describe_env
from maesn.evaluation.evaluate import as_rows
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.exploration import RECORDED_EPISODES, record_exploration
from maesn.evaluation.running import held_latents
from maesn.learners import AbstractMetaLearner, BonusMetaLearner, RecurrentMetaLearner
from maesn.runs.config import CONFIG, RunSettings
from maesn.runs.log import METRICS
from maesn.runs.run import Run
from maesn.runs.serialization import digest_of_document
from maesn.runs.training import train
from maesn.search.stored import prior_file, run_prior
from maesn.storage import (
    explained,
    locked,
    read_json_lines,
    write_arrays,
    write_json,
    write_rows,
)
from maesn.studies.members import RUN, AbstractMember, TrainedRun

DONE, ROWS, LATENTS, EXPLORATION = "done.json", "rows.csv", "latents.npz", "exploration.npz"


@dataclasses.dataclass(frozen=True)
class AbstractJob(ABC):
    """What is computed separately."""

    name: str
    """Of its directory: what it is, and the digest."""
    needs: tuple[str, ...]
    """Names of the jobs that must be done before."""
    steps: int
    """Environment steps that it plays, about: for estimates of time."""

    @abstractmethod
    def compute(self, directory: Path) -> dict[str, Any]:
        """Write the result into the job's directory; return what else is to be known of it."""

    def progress(self, directory: Path) -> float:
        """Return which share is done of a job that is being computed."""
        return 0.0


def is_done(job: str, jobs: Path) -> bool:
    """Whether the result of a job is there."""
    return (jobs / job / DONE).exists()


def run_job(job: AbstractJob, jobs: Path) -> None:
    """Compute a job unless it is done; those that it needs are.

    Raises:
        RunError: something cannot be written, or another process computes the job.
        EpisodeError: an episode went wrong.
    """
    directory = jobs / job.name
    with explained("make", directory):
        directory.mkdir(parents=True, exist_ok=True)
    with locked(directory):
        if is_done(job.name, jobs):
            return
        start = time.perf_counter()
        found = job.compute(directory)
        seconds = round(time.perf_counter() - start, 1)
        write_json(directory / DONE, {"steps": job.steps, "seconds": seconds, **found})


@dataclasses.dataclass(frozen=True)
class TrainJob(AbstractJob):
    """Training of one run, which goes on where it was interrupted."""

    learner: AbstractMetaLearner[Any, Any]
    settings: RunSettings
    init_from: str

    def compute(self, directory: Path) -> dict[str, Any]:
        path, family = directory / RUN, self.settings.own_family
        if (path / CONFIG).exists():
            run = Run.open(path, family)
        else:
            run = Run.create(path, self.learner, self.settings, init_from=self.init_from or None)
        with closing(train(run)) as iterations:
            for _ in iterations:
                pass
        return {"environment_steps": run.latest().environment_steps}

    def progress(self, directory: Path) -> float:
        log = directory / RUN / METRICS
        done = len(read_json_lines(log)) if log.exists() else 0
        return done / max(self.settings.iterations, 1)


@dataclasses.dataclass(frozen=True)
class PriorJob(AbstractJob):
    """The prior over returns of a run, which a search needs, beside its checkpoints."""

    who: TrainedRun
    asked: Evaluation

    def compute(self, directory: Path) -> dict[str, Any]:
        run = self.who.open(directory.parent)
        reward, radius = self.asked.reward, self.asked.sparse_radius
        with closing(run.world(reward_kind=reward, sparse_radius=radius)) as world:
            path = prior_file(run, world)
        if not path.exists():
            run_prior(run, reward=reward, sparse_radius=radius)
        return {"file": path.name}


@dataclasses.dataclass(frozen=True)
class EvaluateJob(AbstractJob):
    """Adaptation of one member to some tasks: a table with one row per task and update.

    Where the method's own rule adapts a latent, the adapted latents go beside it.
    """

    who: AbstractMember
    asked: Evaluation
    tasks: range

    def compute(self, directory: Path) -> dict[str, Any]:
        outcome = self.who.play(self.asked, self.tasks, directory.parent)
        rows = ({**row, "task": self.tasks[row["task"]]} for row in as_rows(outcome))
        write_rows(directory / ROWS, rows)
        latents = held_latents(outcome)
        if latents is not None and not self.asked.label:  # by the method's own rule
            write_arrays(directory / LATENTS, vars(latents))
        return {}


@dataclasses.dataclass(frozen=True)
class RecordJob(AbstractJob):
    """Paths of a run before any adaptation, for figures."""

    who: TrainedRun

    def compute(self, directory: Path) -> dict[str, Any]:
        record_exploration(self.who.open(directory.parent), directory / EXPLORATION)
        return {}


def record_job(member: TrainedRun) -> RecordJob:
    """Return the job that records the paths of a run."""
    env = member.run.env()
    digest = digest_of_document({"of": member.identity, "world": describe_env(env)})
    name = f"record-{env.name}-{member.method}-seed-{member.seed}-{digest}"
    steps = RECORDED_EPISODES * env.horizon
    return RecordJob(name, (member.job,) if member.job else (), steps, member)


def train_job(member: TrainedRun) -> TrainJob:
    """Return the job that trains a run; its steps are those of episodes that end in time."""
    run, learner = member.run, member.run.learner
    inner: Any = learner.learner if isinstance(learner, BonusMetaLearner) else learner
    rounds = (
        inner.trial_episodes
        if isinstance(inner, RecurrentMetaLearner)
        else inner.inner_updates + inner.outer_batches
    )
    episodes = run.settings.iterations * inner.meta_batch_size * run.settings.episodes_per_task
    steps = episodes * rounds * run.env().horizon
    return TrainJob(member.job, (), steps, learner, run.settings, member.init_from)
