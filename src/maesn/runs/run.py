"""Run directories: everything about one training run, and nothing that could be executed.

`docs/reference/files.md` lists what is in one.
"""

import dataclasses
import logging
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from maesn import storage
from maesn.axes import Key
from maesn.envs import NAMED_SETS, AnyEnv, RewardKind, TaskFamily, TaskSet, rebuild_env
from maesn.envs.sources import find_tasks, imported, resolve_family, save_tasks, warn_of_known_tests
from maesn.learners import AbstractMetaLearner, Problem, method_name
from maesn.runs import checkpoint, sources
from maesn.runs.beginning import check_replay, drawn_replay, drawn_state, with_weights_of
from maesn.runs.checkpoint import ITERATION, Checkpoint, CheckpointError, named_leaves
from maesn.runs.config import (
    CONFIG,
    NotNamedError,
    RunConfig,
    RunSettings,
    new_config,
    read_config,
    write_config,
)
from maesn.runs.log import METRICS
from maesn.serialization import digest_of_document, own_type, to_json
from maesn.storage import RunError, refusals
from maesn.worlds import AbstractWorld, check_env_contract, check_policy, make_world

logger = logging.getLogger(__name__)

CHECKPOINTS = "checkpoints"

# No run reaches this iteration, so its key is free for the untrained state. (A split of the seed's
# key would give the keys of iterations 0 and 1 again.)
_UNTRAINED = 0xFFFFFFFF


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """A run directory: its `config.json` and its checkpoints. Made by `create` or `open`."""

    directory: Path
    config: RunConfig
    family: TaskFamily
    training_tasks: TaskSet
    own_family: str | None = None  # `module:name` of a user's own family, where it is known
    own_method: str | None = None  # likewise of a user's own method

    @property
    def typed(self) -> str:
        """The run as commands take it: its directory, and the user's own modules that it needs."""
        own = {"method": self.own_method, "family": self.own_family}
        options = (f" --{option} {name}" for option, name in own.items() if name)
        return shlex.quote(str(self.directory)) + "".join(options)

    @property
    def settings(self) -> RunSettings:
        """Where, on what, how long."""
        return self.config.settings

    @property
    def learner(self) -> AbstractMetaLearner[Any, Any]:
        """The method and its settings."""
        return self.config.learner

    @classmethod
    def create(
        cls,
        directory: str | Path,
        learner: AbstractMetaLearner[Any, Any],
        settings: RunSettings,
        family: TaskFamily | None = None,
        init_from: str | Path | None = None,
    ) -> "Run":
        """Make a new run directory with the state in it that training begins with.

        Arguments are those of `maesn.train`. Weights that tasks share come from the run
        `init_from`, such as policy and step sizes; what belongs to single tasks, such as the
        latents, begins afresh, and so does all that is no weight. What cannot be used, or does
        not fit, is a `RunError`.
        """
        named = settings.family if family is None else family.name
        family = resolve_family(named) if family is None else family
        method = settings.own_method or method_name(learner)
        settings = dataclasses.replace(settings, family=named, method=method)
        tasks = find_tasks(settings.tasks, family)
        config = new_config(settings, learner, family, tasks)
        own = settings.own_family, settings.own_method or own_type(learner)
        run = cls(Path(directory), config, family, tasks, *own)
        with refusals():
            check_env_contract(run.env(), tasks[0])
            learner.check_batch(settings.episodes_per_task)
        if settings.tasks == "training":
            warn_of_known_tests(family, tasks)
        state = run.untrained_state()
        if init_from is not None:
            source = run.source(init_from)
            larger = run.structure(more_tasks=1)
            state = with_weights_of(source.latest_state(), state, larger, learner, source.directory)
            begun = {"init_from": " ".join(source.identity().values())}
            config = dataclasses.replace(config, provenance=begun)
            run = dataclasses.replace(run, config=config)
        check_policy(learner.player(state), run.env())
        check_replay(learner, state, method)
        with storage.locked(run.directory):
            # A process that was killed here may have left its first checkpoint.
            if (run.directory / CONFIG).exists() or len(run.checkpoints()) > 1:
                what_to_do = "choose another directory, or go on with it: maesn resume"
                raise RunError(f"`{directory}` holds a run; {what_to_do} {run.typed}")
            if settings.tasks not in NAMED_SETS:
                save_tasks(run.directory / sources.TASKS_FILE, tasks, family)
            run.save_state(state)
            write_config(run.directory, run.config)  # last: it makes the run whole
        return run

    @classmethod
    def open(
        cls,
        source: "str | Path | Run",
        family: str | TaskFamily | None = None,
        method: str | None = None,
    ) -> "Run":
        """Open a run. Nothing that stands in its directory is executed or imported.

        `source` is a directory, else the name of a policy that comes with the library, or a run,
        which is read again. `family` is that of the run, itself or `module:name`, if it does not
        come with the library. `method` is `module:name` of a method that does not, or of anything
        in the module that its settings are from; a module that is imported need not be named.
        """
        own = family if isinstance(family, str) else None
        if isinstance(source, Run):
            own, family = own or source.own_family, family or source.family
            method, source = method or source.own_method, source.directory
        if method is not None:
            imported(method, "method")
        directory = sources.find_run(source)
        config = read_config(directory)
        if family is None and config.settings.own_family:
            raise NotNamedError(directory, {"family": config.settings.own_family})
        found = sources.recorded_family(config.family, family)
        tasks = sources.recorded_tasks(directory, config.settings.tasks, config.task_digest, found)
        settings = config.settings
        own = own or settings.own_family
        method = method or settings.own_method or own_type(config.learner)
        return cls(directory, config, found, tasks, own, method)

    def env(
        self, reward_kind: RewardKind | None = None, sparse_radius: float | None = None
    ) -> AnyEnv:
        """Return the environment as it was recorded, or with another reward or radius in metres."""
        asked = {"reward_kind": reward_kind, "sparse_radius": sparse_radius}
        changed = {name: value for name, value in asked.items() if value is not None}
        with refusals():
            return rebuild_env(self.family, self.config.world, **changed)

    def task_set(self, name: str | Path = "training") -> TaskSet:
        """Return tasks of the family: `training` is what this run trains on; see `RunSettings`."""
        return self.training_tasks if name == "training" else find_tasks(name, self.family)

    def world(
        self,
        tasks: TaskSet | None = None,
        reward_kind: RewardKind | None = None,
        sparse_radius: float | None = None,
        num_threads: int | None = None,
    ) -> AbstractWorld:
        """Return a world to play in. None stands for what the run itself trains with."""
        tasks = self.training_tasks if tasks is None else tasks
        threads = self.settings.num_threads if num_threads is None else num_threads
        return make_world(self.env(reward_kind, sparse_radius), tasks, threads)

    def iteration_key(self, iteration: int) -> Key:
        """Return the key that all draws of one iteration, 0 to 2^32 - 2, derive from."""
        return jax.random.fold_in(jax.random.key(self.settings.seed), np.uint32(iteration))

    def untrained_state(self) -> Any:
        """Return the state that the seed says; `RunError` if learner and tasks do not fit."""
        with refusals():
            return drawn_state(*self._drawn_from())

    def structure(self, more_tasks: int = 0) -> Any:
        """Return the shapes and types of a state, for that many tasks more than the run has."""
        with refusals():
            return eqx.filter_eval_shape(drawn_state, *self._drawn_from(more_tasks))

    def identity(self, state: Any = None) -> dict[str, str]:
        """Return which learner a state is of, and a digest of its weights; None: the latest."""
        learner = f"{self.settings.method} {digest_of_document(to_json(self.learner))}"
        weights = self.learner.weights(self.latest_state() if state is None else state)
        return {"learner": learner, "weights": checkpoint.digest_of_arrays(weights)}

    def metrics(self) -> list[dict[str, Any]]:
        """Return the metrics of each iteration: name -> number, None if it is not finite."""
        return storage.read_json_lines(self.directory / METRICS)

    def checkpoints(self) -> list[Path]:
        """Return the paths of all checkpoints, the earliest first."""
        found = self.directory.glob(f"{CHECKPOINTS}/{ITERATION}[0-9]*.safetensors")
        return sorted(found, key=lambda path: (len(path.name), path.name))

    def save_state(self, state: Any, environment_steps: int = 0) -> Path:
        """Write a state with the number of control steps played so far, and return the path."""
        iteration = int(self.learner.iteration(state))
        path = self.directory / CHECKPOINTS / f"{ITERATION}{iteration:06d}.safetensors"
        metadata = {
            "family": self.config.family,
            "method": self.settings.method,
            "task set": self.config.task_digest,
            "config": self.config.digest(),
            "iteration": str(iteration),
            "environment_steps": str(environment_steps),
        }
        return checkpoint.save_state(path, state, self.learner.replay(state), metadata)

    def prune(self, path: Path, keep: int) -> None:
        """Delete the checkpoints before a sound one, but for the first and the latest `keep`."""
        checkpoint.read_checkpoint(path)
        paths = self.checkpoints()
        for old in paths[: paths.index(path) + 1][1:-keep]:
            old.unlink()

    def load(self, path: str | Path) -> Checkpoint:
        """Read one checkpoint of this run; `RunError` if it belongs to another one.

        A replay that is gone, damaged or of an older layout begins empty, as `is_whole` says.
        """
        values, metadata = checkpoint.read_checkpoint(Path(path))
        if metadata.get("config") != self.config.digest():
            raise RunError(
                f"`{path}` was written with another `config.json` than this run's: restore that "
                "file."
            )
        structure = self.structure()
        replay = checkpoint.names_of(self.learner.replay(structure), structure) - values.keys()
        beside: Mapping[str, Any] = checkpoint.replay_beside(Path(path)) if replay else {}
        if not (is_whole := replay <= beside.keys()):
            beside = self._empty_replay(structure)
        values |= {name: np.asarray(beside[name]) for name in replay}
        state = checkpoint.restore(structure, values, path)
        iteration, steps = self.learner.iteration(state), metadata.get("environment_steps", "")
        if not steps.isdecimal() or not all(np.isfinite(x).all() for x in values.values()):
            raise CheckpointError(f"`{path}` is damaged: a number in it cannot be.")
        return Checkpoint(state, int(iteration), int(steps), is_whole)

    def latest(self) -> Checkpoint:
        """Return the latest checkpoint that is sound, saying so if a later one is not."""
        for path in reversed(self.checkpoints()):
            try:
                return self.load(path)
            except CheckpointError as error:
                logger.warning("%s Using the one before it.", error)
        raise CheckpointError(f"`{self.directory}` holds no sound checkpoint: restore one.")

    def latest_state(self) -> Any:
        """Return the state of the latest checkpoint; see `latest`."""
        return self.latest().state

    def source(self, init_from: str | Path) -> "Run":
        """Open the run that this one is to start from; see `create`."""
        try:
            same_family = read_config(sources.find_run(init_from)).family == self.config.family
            return Run.open(init_from, self.family if same_family else None)
        except NotNamedError as error:  # no option names the modules of a second run
            raise RunError(
                f"`{init_from}` needs a module of your own, which must be imported before: train "
                "from Python, or import it in the module of your method or family."
            ) from error

    def _empty_replay(self, structure: Any) -> dict[str, Any]:
        """Return by name what the replay is before training; `structure` is that of a state."""
        names = {id(leaf): name for name, leaf in named_leaves(structure).items()}
        held = jax.tree.leaves(self.learner.replay(structure))
        with refusals():
            drawn = jax.tree.leaves(drawn_replay(*self._drawn_from()))
        return {names[id(leaf)]: x for leaf, x in zip(held, drawn, strict=True)}

    def _drawn_from(self, more_tasks: int = 0) -> tuple[Any, ...]:
        """Return what the state before training is drawn from."""
        env, tasks = self.env(), self.training_tasks
        problem = Problem(
            env.observation_size,
            env.action_size,
            num_tasks=len(tasks) + more_tasks,
            description_size=jax.eval_shape(env.describe, tasks[0]).size,
            action_kind=env.action_kind,
            horizon=env.horizon,
            episodes_per_task=self.settings.episodes_per_task,
        )
        return self.learner, self.iteration_key(_UNTRAINED), problem
