"""Who takes part in a study: runs, methods from scratch and baselines, each with one seed."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from maesn import learners
from maesn.envs import AnyEnv, RewardKind, describe_env
from maesn.envs.sources import find_tasks, imported, resolve_family
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.running import identity_of_run
from maesn.learners import (
    AbstractFastLearner,
    AbstractMetaLearner,
    BonusMetaLearner,
    RecurrentMetaLearner,
    method_name,
)
from maesn.rules import Trained, written_out
from maesn.runs.config import RunSettings, make_env, new_config
from maesn.runs.run import Run
from maesn.runs.serialization import digest_of_document, fields_to_json, replaced
from maesn.search.prior import USUAL as USUAL_PRIOR
from maesn.settings import leaves
from maesn.studies.jobs import AbstractJob, PriorJob, TrainedRun, TrainJob, Untrained
from maesn.studies.reading import Place
from maesn.studies.spec import RunSpec, ScratchSpec, StudySpec
from maesn.worlds import check_policy

# What all runs of a study have in common, or what each has of its own, is not a run's to say.
_NOT_OF_A_RUN = ("method", "family", "variant", "engine", "seed", "num_threads")
# What decides no number of a run.
_IMMATERIAL = ("versions", "provenance", "changes")


@dataclasses.dataclass(frozen=True)
class Member:
    """What adapts to new tasks, with one seed. `RunError` says what cannot be."""

    who: TrainedRun | Untrained
    """As its jobs know it."""
    seed: int
    method: str
    """By which it is drawn; empty for a baseline."""
    settings: Mapping[str, Any]
    """By their path."""
    env: Callable[[RewardKind, float | None], AnyEnv]
    """Reward and sparse radius -> the environment of new tasks."""
    fast_learner: Callable[[Evaluation, AnyEnv], AbstractFastLearner[Any]]
    """What learns there, for checks alone."""
    identity: Callable[[AnyEnv], str]
    """What decides how it acts, besides the seed."""
    training: TrainJob | None = None
    """The job that trains it, if it is trained here."""
    run: Run | None = None
    """Read, or as it will be created; None for what is never trained."""

    @property
    def scratch(self) -> ScratchSpec | None:
        """What the study says of a method from scratch; None for everything else."""
        return self.who.scratch if isinstance(self.who, Untrained) else None

    @property
    def training_steps(self) -> int | None:
        """Environment steps of a run that exists."""
        if self.run is None or self.training is not None:
            return None
        return self.run.latest().environment_steps

    def fitted(self, asked: Evaluation) -> Evaluation:
        """Return an evaluation with its radius, and in no more tasks than the member is to have.

        The radius is said because runs may have been trained with another one.
        """
        own = self.scratch.num_tasks if self.scratch else None
        counts = [count for count in (own, asked.num_tasks) if count]
        radius = self.env(asked.reward, asked.sparse_radius).sparse_radius
        return dataclasses.replace(
            asked, num_tasks=min(counts, default=None), sparse_radius=radius or None
        )

    def check(self, asked: Evaluation) -> int | None:
        """Refuse an evaluation that it cannot have; return the length of its trials, if any."""
        env = self.env(asked.reward, asked.sparse_radius)
        try:
            return self.fast_learner(asked, env).capabilities.trial_episodes
        except _PriorIsAsked:
            return None

    def jobs_before(self, name: str, asked: Evaluation, env: AnyEnv) -> list[AbstractJob]:
        """Return what an evaluation needs: training, and the prior of a search."""
        jobs: list[AbstractJob] = [] if self.training is None else [self.training]
        if self.run is None or not isinstance(self.who, TrainedRun) or asked.rule is None:
            return jobs
        if asked.rule.needs_return_prior:
            digest = digest_of_document({"of": self.identity(env), "world": describe_env(env)})
            prior = f"prior-{env.name}-{name}-seed-{self.seed}-{digest}"
            steps = USUAL_PRIOR.steps(env, self.run.training_tasks)
            jobs.append(PriorJob(prior, tuple(job.name for job in jobs), steps, self.who, asked))
        return jobs


def member_of_run(who: TrainedRun, run: Run, training: TrainJob | None = None) -> Member:
    """Return a run as a member."""
    config = run.config.document()

    def fast_learner(asked: Evaluation, env: AnyEnv) -> AbstractFastLearner[Any]:
        trained = Trained(run.learner, _blank_state(run), _no_prior)
        return asked.fast_learner(trained, run.settings.method, env)

    return Member(
        who=who,
        seed=run.settings.seed,
        method=run.settings.method,
        settings=leaves({**config["settings"], "learner": config["learner"]}),
        env=run.env,
        fast_learner=fast_learner,
        identity=lambda _: who.job or " ".join(identity_of_run(run).values()),
        training=training,
        run=run,
    )


def untrained(
    study: StudySpec,
    family: str,
    baseline: str = "",
    scratch: ScratchSpec | None = None,
    seed: int = 0,
) -> Member:
    """Return a baseline or a method from scratch. Of its settings those of the world count."""
    settings = RunSettings(
        family=family, variant=study.variant, engine=study.engine, num_threads=study.threads
    )
    who = Untrained(settings, scratch, baseline)
    return Member(
        who=who,
        seed=seed,
        method=scratch.method if scratch else "",
        settings=fields_to_json(scratch) if scratch else {},
        env=who.env,
        fast_learner=lambda _, env: who.learner(env),
        identity=lambda env: " ".join(written_out(who.learner(env)).split()),
    )


def members_from_scratch(study: StudySpec, name: str, family: str) -> list[Member]:
    """Return the seeds of a method from scratch."""
    spec = study.scratch[name]
    return [untrained(study, family, scratch=spec, seed=seed) for seed in spec.seeds or study.seeds]


def members_of_run(study: StudySpec, name: str, family: str) -> list[Member]:
    """Return the seeds of a run on one family; none if it is not to be on that one.

    Raises:
        RunError: a setting cannot be, or a run that exists cannot be read.
    """
    spec, place = study.runs[name], Place(study.file) / "runs" / name
    if family not in (spec.families or [family]):
        return []
    if spec.directories:
        return [_existing(one, study, family, place) for one in spec.directories]
    seeds = spec.seeds or study.seeds
    made = (make_learner(study, spec, place, family, seed) for seed in seeds)
    return [_to_train(name, *one, spec.init_from, place) for one in made]


def _existing(directory: str, study: StudySpec, family: str, place: Place) -> Member:
    own_family = family if ":" in family else None
    run = Run.open(directory, own_family)
    wanted = (resolve_family(family).name, study.variant)
    found = (run.config.family, run.env().variant)
    if found != wanted:
        place.refuse(
            f"`{run.directory}` must be a run on {' of variant '.join(wanted)}, got one on "
            f"{' of variant '.join(found)}."
        )
    who = TrainedRun(directory=directory, family=own_family)
    return member_of_run(who, run)


def make_learner(
    study: StudySpec, spec: RunSpec, place: Place, family: str, seed: int
) -> tuple[AbstractMetaLearner[Any, Any], RunSettings]:
    """Return learner and settings of a run that is to be trained; `RunError` with the wrong key."""
    usual: dict[str, Any] = {}
    if ":" in spec.preset:
        learner = imported(spec.preset, "preset")()
    elif spec.source == "reference":
        learner = learners.METHODS[spec.preset]()
    else:
        learner = learners.recommended(spec.preset, family)
        usual = learners.recommended_run(spec.preset, family)
    common: dict[str, Any] = {
        "family": family,
        "variant": study.variant,
        "engine": study.engine,
        "seed": seed,
    }
    with place.refusing():
        settings = RunSettings(**common | {"num_threads": study.threads} | usual)
    names = [one for one in fields_to_json(settings) if one not in _NOT_OF_A_RUN]
    on_family = spec.on.get(family, {})
    for path, value in {**spec.changes, **on_family}.items():
        here = place / "on" / family / path if path in on_family else place / path
        try:
            if path in names:
                settings = replaced(settings, {path: value})
            else:
                learner = replaced(learner, {path: value})
        except KeyError:
            own = [one.name for one in dataclasses.fields(RunSpec) if one.name != "changes"]
            here.unknown(path, [*names, *leaves(fields_to_json(learner)), *own], "setting")
        except ValueError as error:
            here.refuse(error)
    return learner, settings


def _to_train(
    name: str,
    learner: AbstractMetaLearner[Any, Any],
    settings: RunSettings,
    init_from: str,
    place: Place,
) -> Member:
    """Return a run that is to be trained; all is checked that can be before."""
    family = resolve_family(settings.family)
    settings = dataclasses.replace(settings, method=method_name(learner))
    with place.refusing():
        learner = learner.for_actions(make_env(family, settings).action_kind)
        learner.check_batch(settings.episodes_per_task)
        tasks = find_tasks(settings.tasks, family)
        run = Run(Path(name), new_config(settings, learner, family, tasks), family, tasks)
        check_policy(learner.player(_blank_state(run)), run.env())
    document = {k: v for k, v in run.config.document().items() if k not in _IMMATERIAL}
    del document["settings"]["checkpoint_every"]
    started = identity_of_run(Run.open(init_from)) if init_from else ""
    digest = digest_of_document(document | {"init_from": started})
    job = TrainJob(
        name=f"train-{family.name}-{name}-seed-{settings.seed}-{digest}",
        needs=(),
        steps=_training_steps(learner, settings, run.env().horizon),
        learner=learner,
        settings=settings,
        init_from=init_from,
    )
    who = TrainedRun(job=job.name, family=settings.own_family)
    return member_of_run(who, run, job)


def _training_steps(
    learner: AbstractMetaLearner[Any, Any], settings: RunSettings, horizon: int
) -> int:
    """Return the environment steps of training, if no episode ends early."""
    inner: Any = learner.learner if isinstance(learner, BonusMetaLearner) else learner
    rounds = (
        inner.trial_episodes
        if isinstance(inner, RecurrentMetaLearner)
        else inner.inner_updates + inner.outer_batches
    )
    episodes = inner.meta_batch_size * settings.episodes_per_task * rounds
    return int(settings.iterations * episodes * horizon)


def _blank_state(run: Run) -> Any:
    """Return a state of zeros, for checks that do not depend on what was learned."""
    return jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), run.structure())


class _PriorIsAsked(Exception):
    """Everything else of a search fits."""


def _no_prior(*_: Any) -> Any:
    raise _PriorIsAsked
