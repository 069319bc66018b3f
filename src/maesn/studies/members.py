"""Who takes part in a study: the runs to be trained, and their settings; runs that exist."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from maesn import learners
from maesn.envs.sources import find_tasks, imported, resolve_family
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.tables import identity_of_run
from maesn.learners import (
    AbstractMetaLearner,
    BonusMetaLearner,
    RecurrentMetaLearner,
    method_name,
)
from maesn.rules import Trained
from maesn.runs.config import RunSettings, make_env, new_config
from maesn.runs.run import Run
from maesn.runs.serialization import digest_of_document, fields_to_json, replaced
from maesn.settings import leaves
from maesn.storage import RunError
from maesn.studies.jobs import TrainedRun, TrainJob
from maesn.studies.reading import Place
from maesn.studies.spec import RunSpec, StudySpec
from maesn.worlds import check_policy

# What all runs of a study have in common, or what each has of its own, is not a run's to say.
_NOT_OF_A_RUN = ("method", "family", "variant", "engine", "seed", "num_threads")
# What decides no number of a run.
_IMMATERIAL = ("versions", "provenance", "changes")


@dataclasses.dataclass(frozen=True)
class Member:
    """A run that takes part, with one seed."""

    who: TrainedRun
    run: Run
    """Read, or as it will be created: its settings, family and environment."""
    training: TrainJob | None = None
    """The job that trains it; None for a run that exists."""

    @property
    def seed(self) -> int:
        """Of its training."""
        return self.run.settings.seed

    @property
    def identity(self) -> str:
        """What decides how it acts."""
        return self.who.job or " ".join(identity_of_run(self.run).values())

    def check(self, evaluation: Evaluation, place: Place) -> int | None:
        """Refuse an evaluation that it cannot have; return the length of its trials, if any.

        Raises:
            RunError: rule, wrappers or budgets do not fit.
        """
        method = self.run.settings.method
        trained = Trained(self.run.learner, _blank_state(self.run), _no_prior)
        try:
            env = self.run.env(evaluation.reward, evaluation.sparse_radius)
            learner = evaluation.fast_learner(trained, method, env)
        except _PriorIsAsked:
            return None
        except RunError as error:
            place.refuse(error)
        return learner.capabilities.trial_episodes


def _blank_state(run: Run) -> Any:
    """Return a state of zeros, for checks that do not depend on what was learned."""
    return jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), run.structure())


class _PriorIsAsked(Exception):
    """Everything else of a search fits."""


def _no_prior(*_: Any) -> Any:
    raise _PriorIsAsked


def members(study: StudySpec, name: str, family: str) -> Iterator[Member]:
    """Yield the runs of one name on one family, one for each seed.

    Raises:
        RunError: a setting cannot be, or a run that exists cannot be read.
    """
    spec, place = study.runs[name], Place(study.file) / "runs" / name
    own_family = family if ":" in family else None
    for directory in spec.directories:
        run = Run.open(directory, own_family)
        wanted = (resolve_family(family).name, study.variant)
        found = (run.config.family, run.env().variant)
        if found != wanted:
            place.refuse(
                f"`{run.directory}` must be a run on {' of variant '.join(wanted)}, got one on "
                f"{' of variant '.join(found)}."
            )
        yield Member(TrainedRun(directory=directory, family=own_family), run)
    for seed in () if spec.directories else spec.seeds or study.seeds:
        learner, settings = made(study, spec, place, family, seed)
        yield _trained(study, name, learner, settings, spec.init_from, place)


def made(
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


def _trained(
    study: StudySpec,
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
    return Member(TrainedRun(job=job.name, family=settings.own_family), run, job)


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
