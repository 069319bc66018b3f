"""Who takes part in a study: runs, methods from scratch and baselines, each with one seed."""

import dataclasses
import inspect
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import jax
import numpy as np

from maesn import learners
from maesn.envs import AnyEnv, TaskSet
from maesn.envs.sources import find_tasks, resolve_family
from maesn.evaluation.adapting import AdaptationOutcome, adapt
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.running import evaluate
from maesn.learners import AbstractFastLearner, AbstractMetaLearner
from maesn.policies import USUAL
from maesn.rules import Trained, written_out
from maesn.runs.config import RunSettings, make_env, new_config
from maesn.runs.run import Run
from maesn.runs.sources import own_method
from maesn.search import latent_of
from maesn.serialization import digest_of_document, fields_to_json, own_type, replaced
from maesn.settings import in_files, leaves, suggestion
from maesn.storage import refusals
from maesn.studies.spec import Place, ScratchSpec, StudySpec, is_for
from maesn.worlds import check_policy, make_world
from maesn.worlds.collector import Collector

RUN = "run"  # in the directory of a job that trains

# Settings that the study decides, or that differ from run to run: `[runs.NAME]` cannot have them.
_NOT_OF_A_RUN = ("method", "family", "variant", "seed", "num_threads")


@dataclasses.dataclass(frozen=True, kw_only=True)
class AbstractMember(ABC):
    """An agent with one seed that adapts to new tasks. Jobs take it to other processes."""

    seed: int
    method: str = ""  # name of the method, which decides its colour; empty for a baseline
    label: str = ""
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # settings by their path
    identity: str  # text that is equal for agents that act alike, seeds apart
    needs: tuple[str, ...] = ()  # the job that trains it, if there is one
    training_steps: int | None = None  # environment steps of earlier training

    @abstractmethod
    def env(self, asked: Evaluation) -> AnyEnv:
        """Return the environment of new tasks."""

    @abstractmethod
    def trial_episodes(self, asked: Evaluation) -> int | None:
        """Return the episodes of a trial, None without trials; `RunError` if they do not fit."""

    @abstractmethod
    def play(self, asked: Evaluation, tasks: Sequence[int], jobs: Path) -> AdaptationOutcome:
        """Adapt to some tasks. `jobs` is the directory of all jobs, where a trained run is."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainedRun(AbstractMember):
    """A run: one that a job trains, or one that exists."""

    run: Run = dataclasses.field(compare=False, repr=False)
    """The run as it is or will be, for plans. Jobs open it themselves."""
    init_from: str = ""  # directory of the run that its training starts from, if any
    directory: str = ""  # directory of a run that exists
    family: str | None = None  # `module:name`, if it is the user's own
    own_method: str | None = None  # `module:name`, if it is the user's own

    def __getstate__(self) -> dict[str, Any]:
        # A family of the user's own need not be anything that can be pickled.
        return vars(self) | {"run": None}

    def env(self, asked: Evaluation) -> AnyEnv:
        return self.run.env(asked.reward, asked.sparse_radius)

    def trial_episodes(self, asked: Evaluation) -> int | None:
        trained = Trained(self.run.learner, _blank_state(self.run))
        if asked.rule is not None and asked.rule.needs_return_prior:  # which is made later
            with refusals(f"`{self.method}` cannot be adapted like this: "):
                latent_of(trained.fast_learner())
            return None
        learner = asked.fast_learner(trained, self.method, self.env(asked))
        return learner.capabilities.trial_episodes

    def has_trained_on(self, tasks: TaskSet) -> bool:
        """Whether these are the tasks that it is trained on."""
        return self.run.config.task_digest == tasks.digest()

    def open(self, jobs: Path) -> Run:
        """Open the run, once it is trained."""
        directory = jobs / self.needs[0] / RUN if self.needs else self.directory
        return Run.open(directory, self.family, self.own_method)

    def play(self, asked: Evaluation, tasks: Sequence[int], jobs: Path) -> AdaptationOutcome:
        return evaluate(self.open(jobs), asked, tasks=tasks)[0]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Untrained(AbstractMember):
    """A learner that was not trained: a method from scratch, or a baseline."""

    world: RunSettings
    """Settings of the environment; the others have no meaning here."""
    learner: AbstractFastLearner[Any]

    def env(self, asked: Evaluation) -> AnyEnv:
        settings = dataclasses.replace(self.world, sparse_radius=asked.sparse_radius)
        return make_env(resolve_family(settings.family), settings, asked.reward)

    def trial_episodes(self, asked: Evaluation) -> int | None:
        return self.learner.capabilities.trial_episodes

    def play(self, asked: Evaluation, tasks: Sequence[int], jobs: Path) -> AdaptationOutcome:
        new = find_tasks(asked.tasks, resolve_family(self.world.family))
        with closing(make_world(self.env(asked), new, self.world.num_threads)) as world:
            collect = Collector(world, asked.budget.per_update)
            return adapt(self.learner, collect, asked, tasks=tasks)


def baselines(world: RunSettings) -> dict[str, Untrained]:
    """Return the agents that learn nothing in a world, by name."""
    env = make_env(resolve_family(world.family), world)
    found = learners.baselines(env.observation_size, env.action_size, env.action_kind)
    return {name.replace(" ", "_"): _untrained(world, found[name]) for name in found}


def members_from_scratch(study: StudySpec, name: str, family: str) -> list[Untrained]:
    """Return the seeds of a method from scratch; `RunError` if it cannot learn in a family."""
    spec, world = study.scratch[name], study.world(family)
    spec = dataclasses.replace(spec, method=spec.method or name)
    with (Place(study.file) / "scratch" / name).refusing():
        learner = scratch_learner(spec, make_env(study.family(family), world))
        seeds = spec.seeds or study.seeds
        _check_seeds(seeds)
    own = {"method": spec.method, "label": spec.label, "settings": fields_to_json(spec)}
    return [_untrained(world, learner, seed, **own) for seed in seeds]


def scratch_learner(spec: ScratchSpec, env: AnyEnv) -> AbstractFastLearner[Any]:
    """Return what learns from scratch; `ValueError` for a setting that the method lacks."""
    make = learners.SCRATCH[spec.method]
    bonus = spec.curiosity_weight and learners.CuriosityBonus(spec.curiosity_weight)
    given = {"max_kl": spec.max_kl, "step_size": spec.step_size, "curiosity": bonus}
    chosen = {name: one for name, one in given.items() if one is not None}
    if unknown := [*chosen.keys() - inspect.signature(make).parameters.keys()]:
        raise ValueError(f"`{spec.method}` has no `{unknown[0]}`.")
    policy = USUAL[env.action_kind]
    return make(env.observation_size, env.action_size, policy=policy, **chosen)


def _untrained(
    world: RunSettings, learner: AbstractFastLearner[Any], seed: int = 0, **own: Any
) -> Untrained:
    identity = " ".join(written_out(learner).split())
    return Untrained(seed=seed, identity=identity, world=world, learner=learner, **own)


def members_of_run(study: StudySpec, name: str, family: str) -> list[TrainedRun]:
    """Return the seeds of a run on one family; none if it is not to be on that one."""
    spec = study.runs[name]
    if not is_for(family, spec):
        return []
    with (Place(study.file) / "runs" / name).refusing():
        own = spec.preset if ":" in spec.preset else None
        members = [_existing(one, study, family, own) for one in spec.directories] or [
            _to_train(study, name, family, seed) for seed in spec.seeds or study.seeds
        ]
        _check_seeds([one.seed for one in members], spec.directories)
    return [dataclasses.replace(one, label=spec.label) for one in members]


def _check_seeds(seeds: Sequence[int], directories: Sequence[str] = ()) -> None:
    """Refuse a seed that takes part twice, which would count as two."""
    if len(set(seeds)) < len(seeds):
        got = f"seeds {', '.join(map(str, seeds))}"
        if directories:
            got += f" of {', '.join(f'`{one}`' for one in directories)}"
        raise ValueError(f"each seed takes part once, got {got}.")


def trained_run(run: Run, identity: str = "", **where: Any) -> TrainedRun:
    """Return a run as a member. Without an `identity`, learner and weights are."""
    config = run.config.document()
    return TrainedRun(
        seed=run.settings.seed,
        method=run.settings.method,
        settings=leaves({**config["settings"], "learner": config["learner"]}),
        identity=identity or " ".join(run.identity().values()),
        run=run,
        family=run.own_family,
        own_method=run.own_method,
        **where,
    )


def _existing(directory: str, study: StudySpec, family: str, method: str | None) -> TrainedRun:
    world = study.world(family)
    run = Run.open(directory, world.family, method)
    if run.env().variant != make_env(study.family(family), world).variant:
        raise ValueError(f"`{directory}` must be a run of the variant `{world.variant}`.")
    where = str(run.directory.resolve())
    return trained_run(run, directory=where, training_steps=run.latest().environment_steps)


def _to_train(study: StudySpec, name: str, family: str, seed: int) -> TrainedRun:
    """Return a run that is to be trained, after all checks that are possible before training."""
    resolved = study.family(family)
    learner, settings = _settings(study, name, family, seed)
    learner = learner.for_actions(make_env(resolved, settings).action_kind)
    learner.check_batch(settings.episodes_per_task)
    tasks = find_tasks(settings.tasks, resolved)
    config = new_config(settings, learner, resolved, tasks)
    own = settings.own_family, settings.own_method or own_type(learner)
    run = Run(Path(name), config, resolved, tasks, *own)
    check_policy(learner.player(_blank_state(run)), run.env())
    named, document = study.runs[name].init_from, config.document()
    source = run.source(named) if named else None
    document["init_from"] = "" if source is None else " ".join(source.identity().values())
    for immaterial in ("versions", "provenance", "changes"):
        del document[immaterial]
    del document["settings"]["checkpoint_every"]
    digest = digest_of_document(document)
    who = f"{in_files(resolved.name)}-{in_files(settings.method)}"
    job = f"train-{who}-seed-{seed}-{digest}"
    start = "" if source is None else str(source.directory.resolve())
    return trained_run(run, digest, needs=(job,), init_from=start)


def _settings(
    study: StudySpec, name: str, family: str, seed: int
) -> tuple[AbstractMetaLearner[Any, Any], RunSettings]:
    spec = study.runs[name]
    preset, usual, world = spec.preset or name, {}, study.world(family)
    if ":" in preset:
        learner = own_method(preset)
    else:
        learner = learners.recommended(preset, world.family)
        usual = learners.recommended_run(preset, world.family)
    settings = dataclasses.replace(world, seed=seed, **usual)
    names = fields_to_json(settings).keys() - _NOT_OF_A_RUN
    changes = leaves(spec.changes) | leaves(spec.on.get(family, {}))
    own = {path: changes.pop(path) for path in names & changes.keys()}
    try:
        settings, learner = replaced(settings, own), replaced(learner, changes)
    except KeyError as error:
        (path,) = error.args
        known = [*vars(spec), *names, *leaves(fields_to_json(learner))]
        raise ValueError(f"there is no setting `{path}`.{suggestion(path, known)}") from error
    method = preset if ":" in preset else learners.method_name(learner)
    return learner, dataclasses.replace(settings, method=method)


def _blank_state(run: Run) -> Any:
    """Return a state of zeros, for checks that do not depend on what was learned."""
    return jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), run.structure())
