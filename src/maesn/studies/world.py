"""The world in which methods are compared, and which runs can play in it."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from maesn.envs import AnyEnv, Variant
from maesn.envs.sources import find_tasks, resolve_family
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.tables import adaptation_record
from maesn.runs.config import RunSettings, check_sizes, make_env
from maesn.runs.run import Run
from maesn.storage import RunError, refusals
from maesn.worlds import AbstractWorld, check_policy, make_world
from maesn.worlds.collector import Collector


@dataclasses.dataclass(frozen=True)
class WorldSettings:
    """The family of a comparison; what is None is what the runs that are compared say."""

    family: str | None = None
    """Family of tasks, or `module:name` of your own."""
    variant: Variant | None = None
    """Rewards of the code behind the published curves, or as printed in the paper."""

    def settings(self, runs: Iterable[Run], evaluation: Evaluation) -> RunSettings:
        """Return the settings of a world in which the runs can be compared.

        Raises:
            RunError: nothing says which family it is, or the runs disagree.
        """
        given: dict[str, Any] = {
            "family": self.family,
            "variant": self.variant,
            "sparse_radius": evaluation.sparse_radius,
            "engine": evaluation.engine,
        }
        for name in [name for name, value in given.items() if value is None]:
            found = list(dict.fromkeys(_of_run(run, name) for run in runs))
            if len(found) > 1:
                listed = " and ".join(map(str, sorted(found, key=str)))
                raise RunError(
                    f"the runs must agree in `{name}` to be compared, got {listed}: say which one "
                    f"with --{name.replace('_', '-')}, or compare fewer runs."
                )
            given[name] = found[0] if found else None
        if given["family"] is None:
            raise RunError("`family` must be given where no run says it: --family NAME.")
        given = {name: value for name, value in given.items() if value is not None}
        return RunSettings(**given, num_threads=evaluation.num_threads or 0)


def _of_run(run: Run, name: str) -> Any:
    """Return what a run says of its world: the values that it was trained with, not defaults."""
    if name == "family":
        return run.settings.own_family or run.config.family
    if name == "engine":
        return run.settings.engine
    return getattr(run.env(), name) or None  # a radius of 0 cannot be asked for


@dataclasses.dataclass(frozen=True, eq=False)
class ComparisonWorld:
    """The world in which methods are compared, and how they are evaluated in it."""

    settings: RunSettings
    """Of the environment; what they say of learning means nothing here."""
    world: AbstractWorld
    evaluation: Evaluation
    """Tasks, reward, budgets. Rules are those of each line."""
    collect: Collector
    deploy: Collector | None
    """Plays the fresh episodes that judge deployed agents; None for none."""

    def close(self) -> None:
        """Stop what plays in the world."""
        self.world.close()

    @property
    def env(self) -> AnyEnv:
        """The environment of the new tasks."""
        return self.world.env

    def record(self, who: Mapping[str, str], evaluation: Evaluation) -> dict[str, Any]:
        """Return what decides the curves of a learner here; see `adaptation_record`."""
        return adaptation_record(who, self.world, self.settings.engine, evaluation)


def comparison_world(
    settings: RunSettings, evaluation: Evaluation, runs: Sequence[Run] = ()
) -> ComparisonWorld:
    """Open the world of a comparison; it is to be closed.

    Args:
        settings: variant, sparse radius, engine and threads.
        evaluation: of all lines.
        runs: that are compared. Their recorded world is played in, whatever has become of the
            family's defaults since.

    Raises:
        RunError: there are no such tasks, or the engine cannot move the environment.
    """
    family = resolve_family(settings.family)
    is_recorded = runs and runs[0].config.family == family.name
    if is_recorded and runs[0].env().variant == settings.variant:
        env = runs[0].env(evaluation.reward, settings.sparse_radius)
    else:
        env = make_env(family, settings, evaluation.reward)
    tasks = find_tasks(evaluation.tasks, family)
    with refusals():
        world = make_world(env, tasks, settings.num_threads, settings.engine)
    collect = Collector(world, evaluation.budget.per_update)
    judged = evaluation.budget.deploy
    deploy = Collector(world, judged) if judged else None
    return ComparisonWorld(settings, world, evaluation, collect, deploy)


def open_oracle(directory: str | Path, family: str | None) -> Run:
    """Open a run, perhaps of the user's own family, whose policy is given the task.

    Raises:
        RunError: it cannot be read, or is a run of another method.
    """
    run = Run.open(directory, family=family)
    if run.settings.method != "oracle":
        raise RunError(
            f"`{run.directory}` must be a run of `oracle`, which is given the task, to be the "
            f"ceiling of a score, but is one of `{run.settings.method}`: train one with `maesn "
            "train oracle`."
        )
    return run


def check_world(runs: Sequence[Run], world: ComparisonWorld) -> None:
    """Refuse runs that were trained in another family, or cannot play in this world.

    Raises:
        RunError: a run was, or cannot.
    """
    for run in runs:
        if run.config.family != world.env.name:
            raise RunError(
                f"`{run.directory}` must be a run on {world.env.name} to be compared there, got "
                f"one on {run.config.family}: leave it out, or give another --family."
            )
        remedy = "compare it in the variant that it was trained in"
        check_sizes(run.directory, run.env(), world.env, remedy)
        check_policy(run.learner.player(run.latest_state()), world.env)
