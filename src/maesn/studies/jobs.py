"""Jobs: the parts of a study that are computed separately, each once.

A job is a directory in `DIR/jobs`, named by a digest of all that decides its numbers. It is done
when `done.json` stands in it, which is written last.
"""

import dataclasses
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from maesn.envs import AnyEnv, RewardKind
from maesn.envs.sources import find_tasks, resolve_family
from maesn.evaluation.evaluate import AdaptationOutcome, as_rows
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.running import evaluate, play
from maesn.learners import (
    SCRATCH,
    AbstractFastLearner,
    AbstractMetaLearner,
    CuriosityBonus,
    baselines,
    reinforce,
)
from maesn.policies import USUAL
from maesn.runs.config import CONFIG, RunSettings, make_env
from maesn.runs.run import Run
from maesn.runs.training import train
from maesn.search.stored import prior_file, run_prior
from maesn.storage import (
    explained,
    locked,
    read_json,
    read_json_lines,
    refusals,
    write_json,
    write_rows,
)
from maesn.studies.spec import ScratchSpec
from maesn.worlds import make_world

DONE, RUN, ROWS = "done.json", "run", "rows.csv"


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

    def is_done(self, jobs: Path) -> bool:
        """Whether the result is there."""
        return (jobs / self.name / DONE).exists()


def run_job(job: AbstractJob, jobs: Path) -> None:
    """Compute a job unless it is done.

    Args:
        job: which; those that it needs are done.
        jobs: directory of all.

    Raises:
        RunError: something cannot be written, or another process computes the job.
        EpisodeError: an episode went wrong.
    """
    directory = jobs / job.name
    with explained("make", directory):
        directory.mkdir(parents=True, exist_ok=True)
    with locked(directory):
        if job.is_done(jobs):
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
    init_from: str = ""

    def compute(self, directory: Path) -> dict[str, Any]:
        """Train, and write down how many steps that took."""
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
        """Return the share of the iterations."""
        log = directory / RUN / "metrics.jsonl"
        done = len(read_json_lines(log)) if log.exists() else 0
        return done / max(self.settings.iterations, 1)


@dataclasses.dataclass(frozen=True)
class TrainedRun:
    """A run that takes part: of a job, or one that exists."""

    job: str = ""
    """Name of the job that trains it; empty for one that exists."""
    directory: str = ""
    """Of one that exists."""
    family: str | None = None
    """`module:name`, if it is the user's own."""

    def open(self, jobs: Path) -> Run:
        """Open the run."""
        return Run.open(jobs / self.job / RUN if self.job else self.directory, self.family)

    def play(self, evaluation: Evaluation, tasks: Sequence[int], jobs: Path) -> AdaptationOutcome:
        """Adapt to some tasks."""
        return evaluate(self.open(jobs), evaluation, tasks=tasks)[0]


@dataclasses.dataclass(frozen=True)
class Untrained:
    """A learner that has not been trained: a method from scratch, or a baseline."""

    settings: RunSettings
    """Of the environment."""
    scratch: ScratchSpec | None = None
    baseline: str = ""

    def learner(self, env: AnyEnv) -> AbstractFastLearner[Any]:
        """Return what learns in new tasks; `RunError` if it cannot learn there."""
        sizes = env.observation_size, env.action_size
        if self.scratch is None:
            return baselines(*sizes, env.action_kind)[self.baseline]
        spec, make = self.scratch, SCRATCH[self.scratch.method]
        given: dict[str, Any] = {"max_kl": spec.max_kl}
        if make is reinforce:
            given = {"step_size": spec.step_size}
        elif spec.curiosity_weight is not None:
            given["curiosity"] = CuriosityBonus(spec.curiosity_weight)
        chosen = {name: value for name, value in given.items() if value is not None}
        with refusals(f"`{spec.method}` cannot learn in `{env.name}`: "):
            return make(*sizes, policy=USUAL[env.action_kind], **chosen)

    def env(self, reward: RewardKind, sparse_radius: float | None) -> AnyEnv:
        """Return the environment of new tasks."""
        settings = dataclasses.replace(self.settings, sparse_radius=sparse_radius)
        return make_env(resolve_family(settings.family), settings, reward)

    def play(self, evaluation: Evaluation, tasks: Sequence[int], _: Path) -> AdaptationOutcome:
        """Adapt to some tasks."""
        family = resolve_family(self.settings.family)
        env = self.env(evaluation.reward, evaluation.sparse_radius)
        new = find_tasks(evaluation.tasks, family)
        with refusals():
            world = make_world(env, new, self.settings.num_threads, self.settings.engine)
        with closing(world):
            return play(world, self.learner(env), evaluation, tasks=tasks)


@dataclasses.dataclass(frozen=True)
class PriorJob(AbstractJob):
    """The prior over returns of a run, which a search needs."""

    run: TrainedRun
    evaluation: Evaluation

    def compute(self, directory: Path) -> dict[str, Any]:
        """Make the prior, beside the checkpoints of the run."""
        one = self.evaluation
        run = self.run.open(directory.parent)
        with closing(run.world(reward_kind=one.reward, sparse_radius=one.sparse_radius)) as world:
            path = prior_file(run, world)
        if not path.exists():
            run_prior(run, reward=one.reward, sparse_radius=one.sparse_radius)
        return {"file": path.name}


@dataclasses.dataclass(frozen=True)
class EvaluateJob(AbstractJob):
    """Adaptation of one learner to some tasks."""

    who: TrainedRun | Untrained
    evaluation: Evaluation
    first: int
    """Index of the first task."""
    count: int
    """Number of tasks."""

    def compute(self, directory: Path) -> dict[str, Any]:
        """Play, and write one row per task and update."""
        tasks = range(self.first, self.first + self.count)
        outcome = self.who.play(self.evaluation, tasks, directory.parent)
        rows = ({**row, "task": tasks[row["task"]]} for row in as_rows(outcome))
        write_rows(directory / ROWS, rows)
        return {}


def done_steps(job: str, jobs: Path) -> int:
    """Return the environment steps that training took."""
    return int(read_json(jobs / job / DONE)["environment_steps"])
