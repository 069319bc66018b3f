"""From what a study says to the jobs that compute it, and the comparisons that they are for."""

import dataclasses
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from maesn.envs import AnyEnv, describe_env
from maesn.envs.sources import find_tasks, resolve_family
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.exploration import RECORDED_EPISODES
from maesn.reporting.style import METHOD_STYLES
from maesn.runs.run import Run
from maesn.runs.serialization import digest_of_document
from maesn.search.prior import PriorSettings
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
from maesn.studies.reading import Place
from maesn.studies.spec import RECORDED, LineSpec, StudySpec
from maesn.worlds import engine_of

Entry: TypeAlias = dict[str, Any]
"""Of the manifest: a comparison, or one of its lines, whose `seeds` are members and their jobs."""


def make_plan(study: StudySpec) -> tuple[dict[str, Job], list[Entry]]:
    """Return what a study computes and what for: jobs by name, and comparisons.

    Each job is behind those that it needs. `RunError` with the place in its file of what cannot be.
    """
    jobs: dict[str, Job] = {}
    planned = [_Planner(study, family, jobs).compare() for family in study.families]
    found = [one for comparisons in planned for one in comparisons]
    if len({one["name"] for one in found}) < len(found):
        wrong = "two families, or two files of tasks, have the same name: rename one"
        raise RunError(f"`{study.file}`: {wrong}.")
    return jobs, found


@dataclasses.dataclass
class _Planner:
    """Plans what a study does on one family."""

    study: StudySpec
    family: str
    jobs: dict[str, Job]
    """Those of the families before, and what is planned here."""
    runs: dict[str, Sequence[TrainedRun]] = dataclasses.field(default_factory=dict)

    def compare(self) -> Iterator[Entry]:
        """Yield what is compared: lines in the same tasks, under the same reward."""
        worlds = defaultdict(list)
        for number, spec in enumerate(self.study.all_lines, start=1):
            if self.family in (spec.families or [self.family]):
                members: Sequence[AbstractMember] = self.run(spec.run) if spec.run else ()
                if spec.scratch:
                    members = members_from_scratch(self.study, spec.scratch, self.family)
                with (Place(self.study.file) / "lines" / number).refusing():
                    for asked, line in self.lines(spec, members):
                        world = asked.tasks, asked.reward, asked.sparse_radius
                        worlds[world].append((asked, line))
        # The name of a comparison is that of the family, and what tells it from others there.
        differs = [len(set(values)) > 1 for values in zip(*worlds, strict=True)]
        for world, lines in worlds.items():
            texts = Path(world[0]).stem, world[1], f"radius-{world[2] or 0:g}"
            told = [text for text, is_told in zip(texts, differs, strict=True) if is_told]
            name = "-".join([resolve_family(self.family).name, *told])
            yield self.comparison(name, lines)

    def run(self, name: str) -> Sequence[TrainedRun]:
        """Return the seeds of a run, none if it is not of this family, and plan their training."""
        if name not in self.runs:
            self.runs[name] = members_of_run(self.study, name, self.family)
            for one in self.runs[name]:
                for job in one.needs:
                    learner, settings = one.run.learner, one.run.settings
                    work = partial(train_run, learner, settings, one.init_from)
                    self.add(job, (), _steps_of_training(one.run), work, settings.iterations)
        return self.runs[name]

    def lines(
        self, spec: LineSpec, members: Sequence[AbstractMember]
    ) -> Iterator[tuple[Evaluation, Entry]]:
        """Yield a line with each of its evaluations."""
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
    ) -> tuple[Evaluation, Entry]:
        """Return a line of members that adapt alike, with its evaluation in full."""
        study, first = self.study, members[0]
        asked = dataclasses.replace(
            asked,
            # It is said because runs may have been trained with another one.
            sparse_radius=first.env(asked).sparse_radius or None,
            seed=study.evaluation_seed,
            engine=study.engine,
            num_threads=study.threads,
        )
        trials = [member.trial_episodes(asked) for member in members]
        num_tasks = asked.count(find_tasks(asked.tasks, resolve_family(self.family)))
        budget = {**asked.budget._asdict(), "num_tasks": num_tasks, "seed": asked.seed}
        return asked, {
            "name": name,
            "source": source,
            "method": first.method,
            "label": first.label,
            "addition": bool(asked.wrappers),
            "settings": first.settings,
            "evaluation": {"rule": asked.rule_text, **budget},
            "trial_episodes": trials[0],
            "seeds": [(one, list(self.evaluate(name, one, asked))) for one in members],
        }

    def comparison(self, name: str, planned: Sequence[tuple[Evaluation, Entry]]) -> Entry:
        """Return a comparison, with agents that learn nothing below, and the oracle above."""
        first, lines = planned[0][0], [line for _, line in planned]
        asked = Evaluation(
            tasks=first.tasks,
            num_tasks=max(line["evaluation"]["num_tasks"] for line in lines),
            reward=first.reward,
            episodes=0,
            sparse_radius=first.sparse_radius,
            tasks_at_once=first.tasks_at_once,
        )
        study, still = self.study, baselines(self.study.world(self.family))
        below = [self.line(name, name, [one], asked) for name, one in still.items()]
        best = self.run(study.oracle) if study.oracle else ()
        above = [self.line("oracle", study.oracle, best, asked)] if best else []
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
            "recorded": dict(self.record(dict.fromkeys(line["source"] for line in lines))),
        }

    def record(self, sources: Iterable[str]) -> Iterator[tuple[str, str]]:
        """Plan what figures of runs need to have recorded; yield names of runs and jobs.

        `sources` are the runs and methods that the comparison has lines of.
        """
        figures = [one for one in self.study.figures if one.kind in RECORDED]
        here = [one for one in figures if self.family in (one.families or [self.family])]
        for name in sources:
            lines = [line for line in self.study.all_lines if name == line.run]
            names = {name, *(one for line in lines for one in self.study.names_of(line).values())}
            drawn = any(not one.lines or names & {*one.lines} for one in here)
            for member in self.runs.get(name, ())[:1]:
                env = member.run.env()
                if drawn and env.planar:
                    digest = _digest(member, env)
                    job = f"record-{env.name}-{member.method}-seed-{member.seed}-{digest}"
                    steps = RECORDED_EPISODES * env.horizon
                    yield name, self.add(job, member.needs, steps, partial(record_run, member))

    def evaluate(self, name: str, member: AbstractMember, asked: Evaluation) -> Iterator[str]:
        """Plan the evaluation of a member, some tasks at a time; yield the names of the jobs."""
        tasks = find_tasks(asked.tasks, resolve_family(self.family))
        budget, env = asked.budget, member.env(asked)
        needs = member.needs
        who = f"{env.name}-{member.method or name}"
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
            "engine": engine_of(env, self.study.engine),
            "tasks": tasks.digest(),
            "budget": [*budget, *asked.deploy_after],
            "seed": asked.seed,
            "threads": self.study.threads,
        }
        if is_search or budget.deploy:
            document |= without_noise
        number = asked.count(tasks)
        for part in np.array_split(np.arange(number), -(-number // asked.tasks_at_once)):
            first, count = int(part[0]), len(part)
            digest = _digest(member, env, **document, part=[first, count])
            job = f"adapt-{who}{asked.suffix}-seed-{member.seed}-from-{first}-{digest}"
            work = partial(adapt_member, member, asked, range(first, first + count))
            yield self.add(job, needs, of_task * count, work)

    def add(self, name: str, *fields: Any) -> str:
        """Plan a job, unless it is planned already; return its name."""
        self.jobs.setdefault(name, Job(name, *fields))
        return name


def _digest(member: AbstractMember, env: AnyEnv, **more: Any) -> str:
    """Return a digest of all that decides a result of a member in a world."""
    return digest_of_document({"of": member.identity, "world": describe_env(env), **more})


def _steps_of_training(run: Run) -> int:
    """Return the steps of a training, as if all episodes ended in time."""
    settings = run.settings
    episodes = run.learner.planned_episodes(settings.episodes_per_task, settings.iterations)
    return episodes * run.env().horizon


def _labelled(planned: Sequence[tuple[Evaluation, Entry]]) -> list[Entry]:
    """Return lines as figures call them: by their methods, and what makes them differ."""
    labels = []
    for asked, line in planned:
        rivals = {one["source"] for _, one in planned if one["method"] == line["method"]}
        usual = line["source"].replace("_", " ")
        if line["method"] in METHOD_STYLES and len(rivals) == 1:
            usual = METHOD_STYLES[line["method"]].label
        labels.append((line["label"] or usual) + (f" ({asked.label})" if asked.label else ""))
    return [
        line | {"label": label if labels.count(label) == 1 else f"{label} [{line['name']}]"}
        for (_, line), label in zip(planned, labels, strict=True)
    ]
