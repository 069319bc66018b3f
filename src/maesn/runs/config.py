"""`config.json`: everything that is needed to rebuild a run, as numbers and names.

The file and every checkpoint hold a digest of all that it says, so a change by hand is noticed.
"""

import contextlib
import dataclasses
import importlib.metadata
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import tyro

from maesn.envs import (
    AnyEnv,
    EnvRecord,
    RewardKind,
    TaskFamily,
    TaskSet,
    Variant,
    describe_env,
    is_own,
)
from maesn.learners import AbstractMetaLearner
from maesn.serialization import (
    UnknownTypeError,
    digest_of_document,
    fields_from_json,
    fields_to_json,
)
from maesn.settings import check_choice, check_numbers
from maesn.storage import RunError, explained, read_json, refusals, write_json
from maesn.worlds.budget import check_memory


class NotNamedError(RunError):
    """A run needs modules of the user's own, and reading it never imports one.

    Attributes:
        named: `method` or `family` -> the module and what is in it.
    """

    def __init__(self, directory: Path, settings: Mapping[str, Any], **found: str) -> None:
        recorded = {option: str(settings.get(option)) for option in ("method", "family")}
        own = found | {option: name for option, name in recorded.items() if is_own(name)}
        self.named = own
        python = ", ".join(f"{option}={name!r}" for option, name in own.items())
        super().__init__(
            f"`{directory}` needs a module of your own, and reading a run never imports one that "
            f"you do not name: add {python}."
        )


# Version of the layout of run directories. It grows when an older reader would misunderstand.
SCHEMA = 3

CONFIG = "config.json"
_SHOWN_RUNS = 3  # in a message

_PACKAGES = ("maesn", "jax", "jaxlib", "equinox", "mujoco", "numpy")
# Older runs wrote `settings.engine` and `changes`. They stay in the document, so that digests and
# the names of jobs stay the same.
_ENGINE = "native"


@dataclasses.dataclass(frozen=True)
class RunSettings:
    """Settings of a run besides those of the learner."""

    method: Annotated[str, tyro.conf.Suppress] = ""
    """Name of the method: a preset, or `module:name` of your own. `Run.create` sets the former."""
    family: str = "wheeled"
    """Family of tasks: one that comes with the library, or `module:name` of your own."""
    variant: Variant = "reference"
    """Source of the reward formulas. reference: the code behind the published curves. paper: the
    paper, as printed. pearl, varibad, metacure: those of `sparse_point`."""
    reward: RewardKind = "dense"
    """Reward in training. The paper trains on dense reward and adapts to sparse."""
    sparse_radius: float | None = None
    """Radius around the goal, in metres, within which sparse reward tells the distance. None: that
    of the family."""
    tasks: str = "training"
    """Tasks to train on: training, validation, test, ood, final, final-2, ood-validation, or the
    path of an `.npz` file."""
    seed: int = 0
    """Seed of all random draws of the run."""
    iterations: int = 300
    """Number of meta-iterations in total."""
    episodes_per_task: int = 20
    """Number of episodes that each task of a meta-batch plays at a time; methods with an inner
    update play as many again after it."""
    checkpoint_every: int = 10
    """Number of iterations between two checkpoints. Another is written at the end and on Ctrl-C."""
    num_threads: int = 0
    """Number of threads of the physics engine. 0: one for each CPU."""

    def __post_init__(self) -> None:
        check_choice("variant", self.variant, Variant)
        check_choice("reward", self.reward, RewardKind)
        check_numbers(self, iterations=0, num_threads=0, episodes_per_task=1, checkpoint_every=1)

    @property
    def own_family(self) -> str | None:
        """The family as it has to be named again, if it is the user's own."""
        return self.family if is_own(self.family) else None

    @property
    def own_method(self) -> str | None:
        """The method as it has to be named again, if it is the user's own."""
        return self.method if ":" in self.method else None


@dataclasses.dataclass(frozen=True)
class RunConfig:
    """The content of `config.json`."""

    settings: RunSettings
    learner: AbstractMetaLearner[Any, Any]
    family: str  # the family's own name, by which it is found again
    world: EnvRecord  # the environment of training
    task_digest: str  # digest of the training tasks
    engine: str  # what moves the world
    versions: dict[str, str]  # versions of Python and of the packages that took part
    # `init_from`: learner and weights that the run began with. `command` and `commit`: how a policy
    # that comes with the library was trained.
    provenance: dict[str, str] = dataclasses.field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """Return all of it but its digest, as JSON values."""
        document = {"schema": SCHEMA, "changes": [], **fields_to_json(self)}
        document["settings"]["engine"] = _ENGINE
        return document

    def digest(self) -> str:
        """Return a hexadecimal hash of all of it: equal if and only if it is."""
        return digest_of_document(self.document())


def new_config(
    settings: RunSettings,
    learner: AbstractMetaLearner[Any, Any],
    family: TaskFamily,
    tasks: TaskSet,
) -> RunConfig:
    """Return what a new run will write down."""
    env = make_env(family, settings)
    check_memory(env, settings.episodes_per_task)  # of one task; a batch of them is checked later
    with refusals():
        made = RunConfig(
            settings=settings,
            learner=learner,
            family=family.name,
            world=describe_env(env),
            task_digest=tasks.digest(),
            engine=env.engine,
            versions=installed_versions(env.engine),
        )
        # As a later process will read it: 1 and 1.0 are one setting, but could be two programs.
        return fields_from_json(RunConfig, fields_to_json(made))


def make_env(
    family: TaskFamily, settings: RunSettings, reward_kind: RewardKind | None = None
) -> AnyEnv:
    """Return the environment that a new run is to have; an existing one has its own, `Run.env`."""
    radius = {} if settings.sparse_radius is None else {"sparse_radius": settings.sparse_radius}
    reward = reward_kind or settings.reward
    with refusals():
        return family.make_env(variant=settings.variant, reward_kind=reward, **radius)


def installed_versions(engine: str) -> dict[str, str]:
    """Return the versions that decide whether a run can be repeated bit for bit."""
    versions = {"python": platform.python_version()}
    for name in (*_PACKAGES, *(["gymnasium"] if engine == "gymnasium" else [])):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[name] = importlib.metadata.version(name)
    return versions


def write_config(directory: Path, config: RunConfig) -> None:
    """Write `config.json`."""
    write_json(directory / CONFIG, config.document() | {"digest": config.digest()})


def read_config(directory: Path) -> RunConfig:
    """Read `config.json`; refuse one that is damaged or was changed by hand."""
    path = directory / CONFIG
    with explained("read", path):
        is_there = path.exists()
    if not is_there:
        raise RunError(
            f"there is no run in `{directory}`{_runs_inside(directory)}: name a directory that "
            "`maesn train` has made."
        )
    document = read_json(path)
    if document.pop("digest", None) != digest_of_document(document):
        raise RunError(
            f"`{path}` was changed since maesn wrote it: restore it. For other settings start a "
            "new run (`maesn train --init-from`)."
        )
    with refusals(f"`{path}` cannot be understood, it may be of another version of maesn: "):
        if document.pop("schema", None) != SCHEMA:
            raise ValueError(f"its schema must be {SCHEMA}.")
        if document.pop("changes", []):
            raise RunError(
                f"the settings of `{directory}` were changed while it trained: train anew."
            )
        settings = document.get("settings")
        if isinstance(settings, dict) and settings.pop("engine", _ENGINE) != _ENGINE:
            raise RunError(
                f"`{directory}` was trained on MJX, which maesn has no more: train anew."
            )
        try:
            return fields_from_json(RunConfig, document)
        except UnknownTypeError as error:
            raise NotNamedError(directory, document["settings"], method=error.tag) from error


def _runs_inside(directory: Path) -> str:
    """Say which directories in this one hold a run, the first ones; nothing if none does."""
    found = sorted(f"`{path.parent}`" for path in directory.glob(f"*/{CONFIG}"))
    more = ", ..." if len(found) > _SHOWN_RUNS else ""
    return f" itself, but in {', '.join(found[:_SHOWN_RUNS])}{more}" if found else ""
