"""From what a study says to the jobs that compute it, and the comparisons that they are for."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from maesn.envs import AnyEnv, RewardKind, TaskSet, Variant, describe_env
from maesn.envs.sources import find_tasks, resolve_family
from maesn.evaluation.evaluation import Evaluation, written_out
from maesn.learners import baselines
from maesn.runs.config import RunSettings
from maesn.runs.serialization import digest_of_document, fields_to_json
from maesn.search.prior import USUAL as USUAL_PRIOR
from maesn.settings import leaves
from maesn.studies.jobs import AbstractJob, EvaluateJob, PriorJob, Untrained
from maesn.studies.members import Member, members
from maesn.studies.reading import Place
from maesn.studies.spec import LineSpec, StudySpec
from maesn.worlds import engine_of


@dataclasses.dataclass(frozen=True)
class PlannedSeed:
    """What one seed of a line is made of."""

    seed: int
    jobs: tuple[str, ...]
    """The evaluations, each of some tasks, in their order."""
    training: str = ""
    """The job that trains it; empty for what is not trained here."""
    training_steps: int | None = None
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
    evaluation: Evaluation
    num_tasks: int
    seeds: tuple[PlannedSeed, ...]
    trial_episodes: int | None = None
    is_addition: bool = False
    """Whether something is added to the method, which is drawn dashed."""
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Of the run, or of the method from scratch, by their path."""


class World(NamedTuple):
    """What lines of one comparison have in common."""

    family: str
    variant: Variant
    tasks: str
    reward: RewardKind
    sparse_radius: float | None


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
    planner = _Planner(study)
    comparisons = tuple(planner.comparisons())
    return Plan(study, planner.jobs, comparisons)


@dataclasses.dataclass
class _Planner:
    study: StudySpec
    jobs: dict[str, AbstractJob] = dataclasses.field(default_factory=dict)
    found: dict[tuple[str, str], list[Member]] = dataclasses.field(default_factory=dict)
    """(run, family) -> its seeds."""
    task_sets: dict[tuple[str, str], TaskSet] = dataclasses.field(default_factory=dict)

    def members(self, name: str, family: str) -> list[Member]:
        """Return the seeds of a run, and plan their training."""
        if (name, family) not in self.found:
            self.found[name, family] = list(members(self.study, name, family))
        for member in self.found[name, family]:
            if member.training is not None:
                self.jobs.setdefault(member.training.name, member.training)
        return self.found[name, family]

    def comparisons(self) -> Iterator[PlannedComparison]:
        """Yield what is compared, family after family."""
        for family in self.study.families:
            worlds: dict[World, list[PlannedLine]] = {}
            for number, line in enumerate(self.study.all_lines, start=1):
                if line.families and family not in line.families:
                    continue
                place = Place(self.study.file) / "lines" / str(number)
                for name in line.evaluation or self.study.evaluations:
                    asked = self.evaluation(name, family)
                    for planned in self.line(line, name, asked, family, place):
                        own = planned.evaluation
                        world = World(
                            family, self.study.variant, own.tasks, own.reward, own.sparse_radius
                        )
                        worlds.setdefault(world, []).append(planned)
            for world, lines in worlds.items():
                yield self.comparison(world, lines)

    def evaluation(self, name: str, family: str) -> Evaluation:
        """Return an evaluation as the jobs of this study do it."""
        study = self.study
        asked = study.evaluations[name].on_family(family)
        return dataclasses.replace(
            asked, seed=study.evaluation_seed, engine=study.engine, num_threads=study.threads
        )

    def line(
        self, line: LineSpec, name: str, asked: Evaluation, family: str, place: Place
    ) -> Iterator[PlannedLine]:
        """Yield a line with one of its evaluations; none where the run is not of this family."""
        study, source = self.study, line.run or line.scratch
        several = len(line.evaluation or study.evaluations) > 1
        several |= sum(source == (one.run or one.scratch) for one in study.all_lines) > 1
        planned = {"name": f"{source}-{name}" if several else source, "source": source}
        if line.scratch:
            spec = study.scratch[source]
            if asked.rule is not None or asked.wrappers:
                if line.evaluation:
                    place.refuse(f"`{source}` begins from scratch, and has no rule of `{name}`.")
                return
            counts = [count for count in (spec.num_tasks, asked.num_tasks) if count]
            asked = dataclasses.replace(asked, num_tasks=min(counts, default=None))
            who = Untrained(self.world_settings(family), spec)
            with place.refusing():
                env = who.env(asked.reward, asked.sparse_radius)
                who.learner(env)
            asked = _in_world(asked, env)
            seeds = [
                self.seed(planned["name"], who, dataclasses.replace(asked, seed=seed), seed, family)
                for seed in spec.seeds or study.seeds
            ]
            one = self.planned(planned, spec.method, line.label or spec.label, asked, seeds, family)
            yield dataclasses.replace(one, settings=fields_to_json(spec))
            return
        run = study.runs[source]
        if run.families and family not in run.families:
            return
        runs = self.members(source, family)
        asked = _in_world(asked, runs[0].run.env(asked.reward, asked.sparse_radius))
        trials = [member.check(asked, place) for member in runs]
        seeds = [self.seed_of_run(planned["name"], one, asked, family) for one in runs]
        method = runs[0].run.settings.method
        one = self.planned(planned, method, line.label or run.label, asked, seeds, family)
        config = runs[0].run.config.document()
        settings = leaves({**config["settings"], "learner": config["learner"]})
        yield dataclasses.replace(one, trial_episodes=trials[0], settings=settings)

    def planned(
        self,
        names: Mapping[str, Any],
        method: str,
        label: str,
        asked: Evaluation,
        seeds: Sequence[PlannedSeed],
        family: str,
    ) -> PlannedLine:
        """Return a line of these seeds."""
        return PlannedLine(
            **names,
            method=method,
            label=label,
            evaluation=asked,
            num_tasks=asked.count(self.tasks(asked.tasks, family)),
            seeds=tuple(seeds),
            is_addition=bool(asked.wrappers),
        )

    def seed_of_run(self, name: str, member: Member, asked: Evaluation, family: str) -> PlannedSeed:
        """Plan what a rule needs of a run, and its evaluation."""
        env = member.run.env(asked.reward, asked.sparse_radius)
        training = member.training
        before = () if training is None else (training.name,)
        if asked.rule is not None and asked.rule.needs_return_prior:
            digest = digest_of_document({"of": member.identity, "world": describe_env(env)})
            prior = f"prior-{env.name}-{name}-seed-{member.seed}-{digest}"
            steps = USUAL_PRIOR.steps(env, member.run.training_tasks)
            self.jobs.setdefault(prior, PriorJob(prior, before, steps, member.who, asked))
            before = (*before, prior)
        planned = self.evaluations(name, member, asked, member.seed, env, family, before)
        trained = None if training else member.run.latest().environment_steps
        return PlannedSeed(member.seed, planned, training.name if training else "", trained)

    def seed(
        self, name: str, who: Untrained, asked: Evaluation, seed: int, family: str
    ) -> PlannedSeed:
        """Plan the evaluation of what is not trained."""
        env = who.env(asked.reward, asked.sparse_radius)
        return PlannedSeed(seed, self.evaluations(name, who, asked, seed, env, family, ()))

    def evaluations(
        self,
        name: str,
        who: Member | Untrained,
        asked: Evaluation,
        seed: int,
        env: AnyEnv,
        family: str,
        needs: tuple[str, ...],
    ) -> tuple[str, ...]:
        """Plan the evaluation of one learner, some tasks at a time; return the jobs' names."""
        tasks, budget = self.tasks(asked.tasks, family), asked.budget
        columns = len(asked.deploy_after) or budget.episodes // budget.per_update + 1
        of_task = (budget.episodes + budget.per_update + budget.deploy * columns) * env.horizon
        document = {
            "of": who.identity if isinstance(who, Member) else _identity(who, env),
            "rule": asked.rule_text,
            "world": describe_env(env),
            "engine": engine_of(env, self.study.engine),
            "tasks": tasks.digest(),
            "budget": [*budget, *asked.deploy_after],
            "seed": asked.seed,
            "threads": self.study.threads,
        }
        number = asked.count(tasks)
        parts = np.array_split(np.arange(number), -(-number // asked.tasks_at_once))
        names = []
        for part in parts:
            first, count = int(part[0]), len(part)
            digest = digest_of_document(document | {"part": [first, count]})
            job = f"adapt-{env.name}-{name}-seed-{seed}-from-{first}-{digest}"
            played = who.who if isinstance(who, Member) else who
            steps = of_task * count
            self.jobs.setdefault(job, EvaluateJob(job, needs, steps, played, asked, first, count))
            names.append(job)
        return tuple(names)

    def comparison(self, world: World, lines: Sequence[PlannedLine]) -> PlannedComparison:
        """Return a comparison, with agents that learn nothing below, and the oracle above."""
        most = max(line.num_tasks for line in lines)
        asked = dataclasses.replace(
            lines[0].evaluation,
            num_tasks=most,
            rule=None,
            wrappers=(),
            deploy_after=(),
            episodes=0,
            episodes_per_update=None,
            deploy_episodes=None,
            seed=self.study.evaluation_seed,
        )
        settings = self.world_settings(world.family)
        env = Untrained(settings).env(world.reward, world.sparse_radius)
        below = []
        for label in baselines(env.observation_size, env.action_size, env.action_kind):
            name = label.replace(" ", "_")
            seed = self.seed(name, Untrained(settings, baseline=label), asked, 0, world.family)
            names = {"name": name, "source": name}
            below.append(self.planned(names, "", label, asked, [seed], world.family))
        above = None
        if self.study.oracle:
            runs = self.members(self.study.oracle, world.family)
            seeds = [self.seed_of_run("oracle", one, asked, world.family) for one in runs]
            names = {"name": "oracle", "source": self.study.oracle}
            above = self.planned(names, "oracle", "", asked, seeds, world.family)
        return PlannedComparison(world, env.horizon, tuple(lines), tuple(below), above)

    def tasks(self, name: str, family: str) -> TaskSet:
        """Return a task set, read once."""
        if (name, family) not in self.task_sets:
            self.task_sets[name, family] = find_tasks(name, resolve_family(family))
        return self.task_sets[name, family]

    def world_settings(self, family: str) -> RunSettings:
        """Return settings of an environment; what they say of learning means nothing."""
        study = self.study
        return RunSettings(
            family=family,
            variant=study.variant,
            engine=study.engine,
            num_threads=study.threads,
        )


def _in_world(asked: Evaluation, env: AnyEnv) -> Evaluation:
    """Return an evaluation that says its radius: runs may have been trained with another one."""
    return dataclasses.replace(asked, sparse_radius=env.sparse_radius or None)


def _identity(who: Untrained, env: AnyEnv) -> str:
    """Return what decides an untrained learner, besides the seed."""
    return " ".join(written_out(who.learner(env)).split())
