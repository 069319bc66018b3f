"""From what a study says to the jobs that compute it."""

import dataclasses
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from maesn.envs import AnyEnv, TaskSet, describe_env, split_variant
from maesn.envs.sources import find_tasks
from maesn.evaluation.evaluation import TASKS_AT_ONCE, Evaluation
from maesn.evaluation.exploration import RECORDED_EPISODES
from maesn.search.prior import PriorSettings
from maesn.serialization import digest_of_document
from maesn.settings import in_files
from maesn.storage import RunError
from maesn.studies.jobs import Job, adapt_member, make_prior, record_run, train_run
from maesn.studies.members import (
    AbstractMember,
    TrainedRun,
    Untrained,
    baselines,
    members_from_scratch,
    members_of_run,
)
from maesn.studies.planned import PlannedComparison, PlannedLine, labelled
from maesn.studies.reading import check_names
from maesn.studies.spec import RECORDED, LineSpec, Place, StudySpec, is_for


def make_plan(study: StudySpec) -> tuple[dict[str, Job], list[PlannedComparison]]:
    """Return the jobs of a study by name, each behind those that it needs, and its comparisons.

    It is a `RunError` with the place in the study's file if something cannot be.
    """
    check_names(study)
    jobs: dict[str, Job] = {}
    planned = [_Planner(study, family, jobs).compare() for family in study.families]
    found = [one for comparisons in planned for one in comparisons]
    if len({one.name for one in found}) < len(found):
        wrong = "two families, or two files of tasks, have the same name: rename one"
        raise RunError(f"`{study.file}`: {wrong}.")
    return jobs, found


@dataclasses.dataclass
class _Planner:
    """Plans what a study does on one family."""

    study: StudySpec
    family: str
    jobs: dict[str, Job]  # all planned jobs, those of earlier families included
    runs: dict[str, Sequence[TrainedRun]] = dataclasses.field(default_factory=dict)

    def compare(self) -> Iterator[PlannedComparison]:
        """Yield a comparison for each set of tasks, reward and radius that lines have."""
        worlds = defaultdict(list)
        for number, spec in enumerate(self.study.all_lines, start=1):
            if is_for(self.family, spec):
                members: Sequence[AbstractMember] = self.run(spec.run) if spec.run else ()
                if spec.scratch:
                    members = members_from_scratch(self.study, spec.scratch, self.family)
                with (Place(self.study.file) / "lines" / number).refusing():
                    for line in self.evaluations(spec, members):
                        asked = line.asked
                        worlds[asked.tasks, asked.reward, asked.sparse_radius].append(line)
        # The name of a comparison is that of the family, and what tells it from others there.
        differs = [len(set(values)) > 1 for values in zip(*worlds, strict=True)]
        for world, lines in worlds.items():
            texts = Path(world[0]).stem, world[1], f"radius-{world[2] or 0:g}"
            told = [text for text, is_told in zip(texts, differs, strict=True) if is_told]
            variant = filter(None, split_variant(self.family)[1:])
            name = "-".join([in_files(self.study.family(self.family).name), *variant, *told])
            yield self.comparison(name, lines)

    def run(self, name: str) -> Sequence[TrainedRun]:
        """Return the seeds of a run, none if it is not for this family, and plan their training."""
        if name not in self.runs:
            self.runs[name] = members_of_run(self.study, name, self.family)
            for one in self.runs[name]:
                for job in one.needs:
                    learner, settings = one.run.learner, one.run.settings
                    work = partial(train_run, learner, settings, one.init_from)
                    each, iterations = settings.episodes_per_task, settings.iterations
                    episodes = learner.planned_episodes(each, iterations)
                    steps = episodes * one.run.env().horizon  # as if all episodes ended in time
                    effort = learner.effort(steps, iterations)
                    self.add(job, (), steps, work, iterations, effort)
        return self.runs[name]

    def evaluations(
        self, spec: LineSpec, members: Sequence[AbstractMember]
    ) -> Iterator[PlannedLine]:
        """Yield a line for each evaluation of a run or a method from scratch."""
        study, source = self.study, spec.run or spec.scratch
        for evaluation, name in study.names_of(spec).items() if members else ():
            chosen = study.evaluations[evaluation]
            asked = chosen.on.get(self.family, chosen.usual)
            if spec.scratch:
                if asked.rule is not None or asked.wrappers:
                    if spec.evaluation:
                        raise ValueError(f"`{source}` has no rule: leave out `{evaluation}`.")
                    continue
                most = study.scratch[source].num_tasks or asked.num_tasks
                if most is not None:
                    asked = dataclasses.replace(asked, num_tasks=min(most, asked.num_tasks or most))
            yield self.line(name, source, members, asked)

    def line(
        self, name: str, source: str, members: Sequence[AbstractMember], asked: Evaluation
    ) -> PlannedLine:
        """Return a line with its evaluation in full, and plan its jobs."""
        asked = dataclasses.replace(
            asked,
            # It is said because runs may have been trained with another one.
            sparse_radius=members[0].env(asked).sparse_radius or None,
            seed=self.study.evaluation_seed,
            num_threads=self.study.threads,
        )
        tasks = self.tasks(asked)
        known = [one.has_trained_on(tasks) for one in members if isinstance(one, TrainedRun)]
        if asked.tasks == "training" and not all(known):
            raise RunError(
                f"`{source}` was trained on tasks of its own, so `training` is not the same set "
                "for all lines: name a file of tasks."
            )
        trials = [member.trial_episodes(asked) for member in members]
        seeds = [(one, [*self.evaluate(name, one, asked)]) for one in members]
        trained_on = any(known) and asked.tasks != "training"
        return PlannedLine(name, source, asked, asked.count(tasks), trials[0], trained_on, seeds)

    def comparison(self, name: str, lines: Sequence[PlannedLine]) -> PlannedComparison:
        """Return a comparison, with agents that learn nothing below, and the oracle above."""
        study, first = self.study, lines[0].asked
        asked = Evaluation(
            tasks=first.tasks,
            num_tasks=max(line.num_tasks for line in lines),
            reward=first.reward,
            episodes=0,
            sparse_radius=first.sparse_radius,
            tasks_at_once=first.tasks_at_once,
        )
        still = baselines(study.world(self.family))
        below = [self.line(name, name, [one], asked) for name, one in still.items()]
        best = self.run(study.oracle) if study.oracle else ()
        with (Place(study.file) / "oracle").refusing():
            above = [self.line("oracle", study.oracle, best, asked)] if best else []
        world = {
            "family": self.family,
            "variant": study.world(self.family).variant,
            "tasks": first.tasks,
            "reward": first.reward,
            "sparse_radius": first.sparse_radius,
            "horizon": below[0].first.env(asked).horizon,
        }
        references = {line.name for line in (*below, *above)}
        with (Place(study.file) / "lines").refusing():
            if taken := [line.name for line in lines if line.name in references]:
                raise ValueError(
                    f"`{taken[0]}` is the name of a reference: rename what is called so."
                )
        groups = {"lines": lines, "baselines": below, "oracle": above}
        named = {group: labelled(found) for group, found in groups.items()}
        recorded = dict(self.record(dict.fromkeys(line.source for line in lines)))
        return PlannedComparison(name, world, named, recorded)

    def record(self, sources: Iterable[str]) -> Iterator[tuple[str, str]]:
        """Plan the recordings that figures need; yield names of runs and jobs.

        `sources` are the runs and methods that the comparison has lines of.
        """
        figures = [
            one for one in self.study.figures if one.kind in RECORDED and is_for(self.family, one)
        ]
        for name in sources:
            lines = [line for line in self.study.all_lines if name == line.run]
            names = {name, *(one for line in lines for one in self.study.names_of(line).values())}
            drawn = any(not one.lines or names & {*one.lines} for one in figures)
            for member in self.runs.get(name, ())[:1]:
                env = member.run.env()
                if drawn and env.planar:
                    digest = _digest(member, env)
                    who = f"{in_files(env.name)}-{in_files(member.method)}"
                    job = f"record-{who}-seed-{member.seed}-{digest}"
                    steps = RECORDED_EPISODES * env.horizon
                    yield name, self.add(job, member.needs, steps, partial(record_run, member))

    def evaluate(self, name: str, member: AbstractMember, asked: Evaluation) -> Iterator[str]:
        """Plan the evaluation of a member, some tasks at a time; yield the names of the jobs."""
        tasks, budget, env, needs = self.tasks(asked), asked.budget, member.env(asked), member.needs
        who = f"{in_files(env.name)}-{in_files(member.method or name)}"
        without_noise = {} if asked.action_noise else {"action_noise": False}
        is_search = asked.rule is not None and asked.rule.needs_return_prior
        if is_search and isinstance(member, TrainedRun):
            settings = PriorSettings(action_noise=asked.action_noise)
            steps = settings.steps(env, member.run.training_tasks)
            digest = _digest(member, env, **without_noise)
            prior = f"prior-{who}-seed-{member.seed}-{digest}"
            needs += (self.add(prior, needs, steps, partial(make_prior, member, asked)),)
        if isinstance(member, Untrained) and member.method:
            # From scratch, the seed is that of fresh policies and of the episodes.
            asked = dataclasses.replace(asked, seed=member.seed)
        columns = len(asked.deploy_after) or budget.episodes // budget.per_update + 1
        of_task = (budget.episodes + budget.per_update + budget.deploy * columns) * env.horizon
        document = {
            "rule": asked.rule_text,
            "engine": env.engine,
            "tasks": tasks.digest(),
            "budget": [*budget, *asked.deploy_after],
            "seed": asked.seed,
            "threads": self.study.threads,
        }
        if is_search or budget.deploy:
            document |= without_noise
        # A job's name has its tasks, so they must not depend on the memory of a machine.
        number, most = asked.count(tasks), asked.tasks_at_once or TASKS_AT_ONCE
        for part in np.array_split(np.arange(number), -(-number // most)):
            first, count = int(part[0]), len(part)
            digest = _digest(member, env, **document, part=[first, count])
            job = f"adapt-{who}{asked.suffix}-seed-{member.seed}-from-{first}-{digest}"
            work = partial(adapt_member, member, asked, range(first, first + count))
            yield self.add(job, needs, of_task * count, work)

    def tasks(self, asked: Evaluation) -> TaskSet:
        """Return the set of tasks that an evaluation names."""
        return find_tasks(asked.tasks, self.study.family(self.family))

    def add(self, name: str, *fields: Any) -> str:
        """Plan a job, unless it is planned already; return its name."""
        self.jobs.setdefault(name, Job(name, *fields))
        return name


def _digest(member: AbstractMember, env: AnyEnv, **more: Any) -> str:
    return digest_of_document({"of": member.identity, "world": describe_env(env), **more})
