"""From what a study says to the jobs that compute it, and the comparisons that they are for."""

import dataclasses
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from maesn.envs import AnyEnv, TaskSet, describe_env
from maesn.envs.sources import find_tasks, resolve_family
from maesn.evaluation.evaluation import Evaluation
from maesn.reporting.style import METHOD_STYLES
from maesn.runs.serialization import digest_of_document
from maesn.search.prior import USUAL as USUAL_PRIOR
from maesn.studies.jobs import AbstractJob, EvaluateJob, PriorJob, record_job, train_job
from maesn.studies.members import (
    AbstractMember,
    TrainedRun,
    Untrained,
    baselines,
    members_from_scratch,
    members_of_run,
)
from maesn.studies.reading import Place
from maesn.studies.spec import RECORDED, LineSpec, StudySpec
from maesn.worlds import engine_of

Entry: TypeAlias = dict[str, Any]
"""Of the manifest: a comparison, or one of its lines, whose `seeds` are members and their jobs."""


class Plan(NamedTuple):
    """What a study computes, and what for."""

    jobs: Mapping[str, AbstractJob]
    """By name, each behind those that it needs."""
    comparisons: Sequence[Entry]


def make_plan(study: StudySpec) -> Plan:
    """Return the plan of a study; `RunError` with the place in its file of what cannot be."""
    jobs: dict[str, AbstractJob] = {}
    planners = [_Planner(study, family, jobs) for family in study.families]
    return Plan(jobs, [one for planner in planners for one in planner.compare()])


@dataclasses.dataclass
class _Planner:
    """Plans what a study does on one family."""

    study: StudySpec
    family: str
    jobs: dict[str, AbstractJob]
    """Those of the families before, and what is planned here."""
    runs: dict[str, Sequence[TrainedRun]] = dataclasses.field(default_factory=dict)
    task_sets: dict[str, TaskSet] = dataclasses.field(default_factory=dict)

    def compare(self) -> Iterator[Entry]:
        """Yield what is compared: lines in the same tasks, under the same reward."""
        worlds = defaultdict(list)
        for number, spec in enumerate(self.study.all_lines, start=1):
            if self.family in (spec.families or [self.family]):
                for asked, line in self.lines(spec, Place(self.study.file, ("lines", str(number)))):
                    world = asked.tasks, asked.reward, asked.sparse_radius
                    worlds[world].append((asked, line))
        # The name of a comparison is that of the family, and what tells it from others there.
        differs = [len(set(values)) > 1 for values in zip(*worlds, strict=True)]
        for world, lines in worlds.items():
            texts = Path(world[0]).stem, world[1], f"radius-{world[2] or 0:g}"
            told = [text for text, is_told in zip(texts, differs, strict=True) if is_told]
            name = "-".join([self.family.rpartition(":")[2], *told])
            yield self.comparison(name, lines)

    def lines(self, spec: LineSpec, place: Place) -> Iterator[tuple[Evaluation, Entry]]:
        """Yield a line with each of its evaluations; none where the run is not of this family."""
        study, source = self.study, spec.run or spec.scratch
        members: Sequence[AbstractMember]
        if spec.run:
            members, label, most = self.run(source), study.runs[source].label, None
        else:
            with place.refusing():
                members = members_from_scratch(study, source, self.family)
            label, most = study.scratch[source].label, study.scratch[source].num_tasks
        names = spec.evaluation or tuple(study.evaluations)
        rivals = [one for one in study.all_lines if source == (one.run or one.scratch)]
        for evaluation in names if members else ():
            asked = study.evaluations[evaluation].on_family(self.family)
            if spec.scratch and (asked.rule is not None or asked.wrappers):
                if spec.evaluation:
                    place.refuse(
                        f"`{source}` begins from scratch, and has no rule of `{evaluation}`."
                    )
                continue
            name = f"{source}-{evaluation}" if len(names) > 1 or len(rivals) > 1 else source
            if most is not None:
                asked = dataclasses.replace(asked, num_tasks=min(most, asked.num_tasks or most))
            yield self.line((name, source, spec.label or label), members, asked, place)

    def line(
        self,
        names: tuple[str, str, str],
        members: Sequence[AbstractMember],
        asked: Evaluation,
        place: Place,
    ) -> tuple[Evaluation, Entry]:
        """Return a line, called by name, source and label, of members that adapt alike."""
        (name, source, label), study = names, self.study
        with place.refusing():
            asked = dataclasses.replace(
                asked,
                # It is said because runs may have been trained with another one.
                sparse_radius=members[0].env(asked).sparse_radius or None,
                seed=study.evaluation_seed,
                engine=study.engine,
                num_threads=study.threads,
            )
            trials = [member.trial_episodes(asked) for member in members]
        num_tasks = asked.count(self.tasks(asked.tasks))
        budget = {**asked.budget._asdict(), "num_tasks": num_tasks, "seed": asked.seed}
        return asked, {
            "name": name,
            "source": source,
            "method": members[0].method,
            "label": label,
            "addition": bool(asked.wrappers),
            "settings": members[0].settings,
            "evaluation": {"rule": asked.rule_text, **budget},
            "trial_episodes": trials[0],
            "seeds": [(one, list(self.evaluate(name, one, asked))) for one in members],
        }

    def comparison(self, name: str, planned: Sequence[tuple[Evaluation, Entry]]) -> Entry:
        """Return a comparison, with agents that learn nothing below, and the oracle above."""
        first, lines = planned[0][0], [line for _, line in planned]
        asked = dataclasses.replace(
            first,
            num_tasks=max(line["evaluation"]["num_tasks"] for line in lines),
            rule=None,
            wrappers=(),
            deploy_after=(),
            episodes=0,
            episodes_per_update=None,
            deploy_episodes=None,
        )
        study, place = self.study, Place(self.study.file)
        still = baselines(study.world(self.family))
        below = [self.line((name, name, ""), [one], asked, place) for name, one in still.items()]
        members = self.run(study.oracle) if study.oracle else []
        above = [self.line(("oracle", study.oracle, ""), members, asked, place)] if members else []
        return {
            "name": name,
            "family": self.family,
            "variant": study.variant,
            "tasks": first.tasks,
            "reward": first.reward,
            "sparse_radius": first.sparse_radius,
            "horizon": next(iter(still.values())).env(asked).horizon,
            "lines": _labelled(planned),
            "baselines": _labelled(below),
            "oracle": _labelled(above),
            "recorded": self.recorded(dict.fromkeys(line["source"] for line in lines)),
        }

    def recorded(self, sources: Collection[str]) -> dict[str, str]:
        """Plan what figures of runs need to have recorded; return the jobs by the runs' names.

        `sources` are the runs and methods that the comparison has lines of.
        """
        drawn = {
            name
            for figure in self.study.figures
            if figure.kind in RECORDED and self.family in (figure.families or [self.family])
            for name in figure.lines or sources
        }
        jobs = {
            name: record_job(first)
            for name in sources
            for first in self.runs.get(name, ())[:1]
            if name in drawn and first.run.env().planar
        }
        self.jobs.update({job.name: job for job in jobs.values()})
        return {name: job.name for name, job in jobs.items()}

    def evaluate(self, name: str, member: AbstractMember, asked: Evaluation) -> Iterator[str]:
        """Plan the evaluation of a member, some tasks at a time; yield the names of the jobs."""
        tasks, budget, env = self.tasks(asked.tasks), asked.budget, member.env(asked)
        needs = self.needs(name, member, asked, env)
        if isinstance(member, Untrained) and member.method:
            # From scratch, the seed is that of fresh policies and of the episodes.
            asked = dataclasses.replace(asked, seed=member.seed)
        columns = len(asked.deploy_after) or budget.episodes // budget.per_update + 1
        of_task = (budget.episodes + budget.per_update + budget.deploy * columns) * env.horizon
        document = {
            "of": member.identity,
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
            some = range(first, first + count)
            self.jobs.setdefault(job, EvaluateJob(job, needs, of_task * count, member, asked, some))
            yield job

    def needs(
        self, name: str, member: AbstractMember, asked: Evaluation, env: AnyEnv
    ) -> tuple[str, ...]:
        """Return the jobs before an evaluation: training and, planned here, a search's prior."""
        training = (member.job,) if member.job else ()
        is_search = asked.rule is not None and asked.rule.needs_return_prior
        if not (is_search and isinstance(member, TrainedRun)):
            return training
        digest = digest_of_document({"of": member.identity, "world": describe_env(env)})
        prior = f"prior-{env.name}-{name}-seed-{member.seed}-{digest}"
        steps = USUAL_PRIOR.steps(env, member.run.training_tasks)
        self.jobs.setdefault(prior, PriorJob(prior, training, steps, member, asked))
        return (*training, prior)

    def run(self, name: str) -> Sequence[TrainedRun]:
        """Return the seeds of a run, none if it is not of this family, and plan their training."""
        if name not in self.runs:
            self.runs[name] = members_of_run(self.study, name, self.family)
            self.jobs.update({one.job: train_job(one) for one in self.runs[name] if one.job})
        return self.runs[name]

    def tasks(self, name: str) -> TaskSet:
        """Return a task set, read once."""
        if name not in self.task_sets:
            self.task_sets[name] = find_tasks(name, resolve_family(self.family))
        return self.task_sets[name]


def _labelled(planned: Sequence[tuple[Evaluation, Entry]]) -> list[Entry]:
    """Return lines as figures call them: by their methods, and what makes them differ."""
    labels = []
    for asked, line in planned:
        rivals = {one["source"] for _, one in planned if one["method"] == line["method"]}
        is_alone = line["method"] in METHOD_STYLES and len(rivals) == 1
        usual = (
            METHOD_STYLES[line["method"]].label if is_alone else line["source"].replace("_", " ")
        )
        labels.append((line["label"] or usual) + (f" ({asked.label})" if asked.label else ""))
    return [
        line | {"label": label if labels.count(label) == 1 else f"{label} [{line['name']}]"}
        for (_, line), label in zip(planned, labels, strict=True)
    ]
