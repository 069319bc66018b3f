"""From what a study says to the jobs that compute it, and the comparisons that they are for."""

import dataclasses
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from maesn.envs import AnyEnv, RewardKind, TaskSet, Variant, describe_env
from maesn.envs.sources import find_tasks, resolve_family
from maesn.evaluation.evaluation import Evaluation
from maesn.learners import baselines
from maesn.runs.serialization import digest_of_document
from maesn.studies.jobs import AbstractJob, EvaluateJob
from maesn.studies.members import (
    Member,
    members_from_scratch,
    members_of_run,
    untrained,
)
from maesn.studies.reading import Place
from maesn.studies.spec import LineSpec, RunSpec, ScratchSpec, StudySpec
from maesn.worlds import engine_of


class World(NamedTuple):
    """What lines of one comparison have in common."""

    family: str
    variant: Variant
    tasks: str
    reward: RewardKind
    sparse_radius: float | None


@dataclasses.dataclass(frozen=True)
class PlannedSeed:
    """What one seed of a line is made of."""

    seed: int
    jobs: tuple[str, ...]
    """The evaluations, each of some tasks, in their order."""
    training: str
    """The job that trains it; empty for what is not trained here."""
    training_steps: int | None
    """Environment steps of a run that exists."""


@dataclasses.dataclass(frozen=True)
class PlannedLine:
    """One line of a comparison."""

    name: str
    source: str
    """Name of the run or of the method from scratch."""
    method: str
    """By which it is drawn."""
    label: str
    world: World
    evaluation: Evaluation
    num_tasks: int
    seeds: tuple[PlannedSeed, ...]
    trial_episodes: int | None
    settings: Mapping[str, Any]
    """Of the run, or of the method from scratch, by their path."""

    @property
    def is_addition(self) -> bool:
        """Whether something is added to the method, which is drawn dashed."""
        return bool(self.evaluation.wrappers)


@dataclasses.dataclass(frozen=True)
class PlannedComparison:
    """Lines in the same tasks, and the references below and above them."""

    world: World
    horizon: int
    lines: tuple[PlannedLine, ...]
    baselines: tuple[PlannedLine, ...]
    oracle: PlannedLine | None


@dataclasses.dataclass(frozen=True)
class Plan:
    """Jobs by name, each behind those that it needs, and what is compared."""

    study: StudySpec
    jobs: Mapping[str, AbstractJob]
    comparisons: tuple[PlannedComparison, ...]


def make_plan(study: StudySpec) -> Plan:
    """Return the plan of a study.

    Raises:
        RunError: something cannot be computed, with its place in the study's file.
    """
    jobs: dict[str, AbstractJob] = {}
    comparisons = [one for name in study.families for one in _Planner(study, name, jobs).compare()]
    return Plan(study, jobs, tuple(comparisons))


@dataclasses.dataclass
class _Planner:
    """Plans what a study does on one family."""

    study: StudySpec
    family: str
    jobs: dict[str, AbstractJob]
    """Those of the families before, and what is planned here."""
    runs: dict[str, list[Member]] = dataclasses.field(default_factory=dict)
    task_sets: dict[str, TaskSet] = dataclasses.field(default_factory=dict)

    def compare(self) -> Iterator[PlannedComparison]:
        """Yield what is compared."""
        worlds = defaultdict(list)
        for number, line in enumerate(self.study.all_lines, start=1):
            if self.family in (line.families or [self.family]):
                for planned in self.lines(line, Place(self.study.file) / "lines" / str(number)):
                    worlds[planned.world].append(planned)
        for lines in worlds.values():
            yield self.comparison(lines)

    def lines(self, line: LineSpec, place: Place) -> Iterator[PlannedLine]:
        """Yield a line with each of its evaluations; none where the run is not of this family."""
        study, source = self.study, line.run or line.scratch
        spec: RunSpec | ScratchSpec
        members: Sequence[Member]
        if line.run:
            spec, members = study.runs[source], self.run(source)
        else:
            spec = study.scratch[source]
            members = members_from_scratch(study, source, self.family)
        names = line.evaluation or tuple(study.evaluations)
        rivals = [one for one in study.all_lines if source == (one.run or one.scratch)]
        for evaluation in names if members else ():
            asked = self.evaluation(evaluation)
            if line.scratch and (asked.rule is not None or asked.wrappers):
                if line.evaluation:
                    place.refuse(
                        f"`{source}` begins from scratch, and has no rule of `{evaluation}`."
                    )
                continue
            name = f"{source}-{evaluation}" if len(names) > 1 or len(rivals) > 1 else source
            yield self.line((name, source, line.label or spec.label), members, asked, place)

    def line(
        self,
        names: tuple[str, str, str],
        members: Sequence[Member],
        asked: Evaluation,
        place: Place,
    ) -> PlannedLine:
        """Return a line, called by name, source and label, of members that adapt alike."""
        name, source, label = names
        with place.refusing():
            asked = members[0].fitted(asked)
            trials = [member.check(asked) for member in members]
        world = World(
            self.family, self.study.variant, asked.tasks, asked.reward, asked.sparse_radius
        )
        return PlannedLine(
            name=name,
            source=source,
            method=members[0].method,
            label=label,
            world=world,
            evaluation=asked,
            num_tasks=asked.count(self.tasks(asked.tasks)),
            seeds=tuple(self.seed(name, member, asked) for member in members),
            trial_episodes=trials[0],
            settings=members[0].settings,
        )

    def comparison(self, lines: Sequence[PlannedLine]) -> PlannedComparison:
        """Return a comparison, with agents that learn nothing below, and the oracle above."""
        asked = dataclasses.replace(
            lines[0].evaluation,
            num_tasks=max(line.num_tasks for line in lines),
            rule=None,
            wrappers=(),
            deploy_after=(),
            episodes=0,
            episodes_per_update=None,
            deploy_episodes=None,
            seed=self.study.evaluation_seed,
        )
        place = Place(self.study.file)
        env = untrained(self.study, self.family).env(asked.reward, asked.sparse_radius)
        below = []
        for label in baselines(env.observation_size, env.action_size, env.action_kind):
            name, still = label.replace(" ", "_"), untrained(self.study, self.family, label)
            below.append(self.line((name, name, label), [still], asked, place))
        above = None
        if self.study.oracle and (oracle := self.run(self.study.oracle)):
            above = self.line(("oracle", self.study.oracle, ""), oracle, asked, place)
        return PlannedComparison(lines[0].world, env.horizon, tuple(lines), tuple(below), above)

    def seed(self, name: str, member: Member, asked: Evaluation) -> PlannedSeed:
        """Plan what an evaluation needs of a member, and itself."""
        env = member.env(asked.reward, asked.sparse_radius)
        needs = {job.name: job for job in member.jobs_before(name, asked, env)}
        self.jobs.update({job: needs[job] for job in needs if job not in self.jobs})
        jobs = tuple(self.evaluations(name, member, asked, env, tuple(needs)))
        training = member.training.name if member.training else ""
        return PlannedSeed(member.seed, jobs, training, member.training_steps)

    def evaluations(
        self,
        name: str,
        member: Member,
        asked: Evaluation,
        env: AnyEnv,
        needs: tuple[str, ...],
    ) -> Iterable[str]:
        """Plan the evaluation of one member, some tasks at a time; yield the jobs' names."""
        tasks, budget = self.tasks(asked.tasks), asked.budget
        if member.scratch is not None:
            asked = dataclasses.replace(asked, seed=member.seed)
        columns = len(asked.deploy_after) or budget.episodes // budget.per_update + 1
        of_task = (budget.episodes + budget.per_update + budget.deploy * columns) * env.horizon
        document = {
            "of": member.identity(env),
            "rule": asked.rule_text,
            "world": describe_env(env),
            "engine": engine_of(env, self.study.engine),
            "tasks": tasks.digest(),
            "budget": [*budget, *asked.deploy_after],
            "seed": asked.seed,
            "threads": self.study.threads,
        }
        number = asked.count(tasks)
        for part in np.array_split(np.arange(number), -(-number // asked.tasks_at_once)):
            first, count = int(part[0]), len(part)
            digest = digest_of_document(document | {"part": [first, count]})
            job = f"adapt-{env.name}-{name}-seed-{member.seed}-from-{first}-{digest}"
            evaluate = EvaluateJob(job, needs, of_task * count, member.who, asked, first, count)
            self.jobs.setdefault(job, evaluate)
            yield job

    def run(self, name: str) -> Sequence[Member]:
        """Return the seeds of a run, none if it is not of this family, and plan their training."""
        if name not in self.runs:
            self.runs[name] = members_of_run(self.study, name, self.family)
            trainings = [member.training for member in self.runs[name]]
            self.jobs.update({job.name: job for job in trainings if job is not None})
        return self.runs[name]

    def evaluation(self, name: str) -> Evaluation:
        """Return an evaluation as the jobs of this study do it."""
        study = self.study
        return dataclasses.replace(
            study.evaluations[name].on_family(self.family),
            seed=study.evaluation_seed,
            engine=study.engine,
            num_threads=study.threads,
        )

    def tasks(self, name: str) -> TaskSet:
        """Return a task set, read once."""
        if name not in self.task_sets:
            self.task_sets[name] = find_tasks(name, resolve_family(self.family))
        return self.task_sets[name]
