"""A trained run in new tasks, from what a user names to curves and their record.

The types of arguments say as well how the command line reads them: rules as text, such as
`gradient step_scale=2`, or a class of your own.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import jax
import tyro
from tyro.constructors import PrimitiveConstructorSpec

from maesn.context import Latent
from maesn.envs import TaskFamily
from maesn.envs.sources import imported
from maesn.evaluation.evaluate import AdaptationOutcome, adapt
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.tables import adaptation_record, identity_of_run, read_latents
from maesn.learners import AbstractFastLearner, SavedContexts
from maesn.rules import (
    AbstractRule,
    AbstractWrapper,
    BestOfRule,
    CmaEsRule,
    CrossEntropyRule,
    GradientRule,
    MemoryRule,
    NoAdaptation,
    SearchRule,
    ThenReinforce,
    ThenTrpo,
    Trained,
    VimeBonus,
)
from maesn.runs.run import Run
from maesn.runs.serialization import fields_to_json, replaced, values_of_words
from maesn.runs.sources import working_copy
from maesn.search.stored import find_prior
from maesn.storage import RunError, refusals, refuse_links
from maesn.worlds import AbstractWorld, check_policy
from maesn.worlds.collector import Collector

KNOWN: dict[str, dict[str, type[AbstractRule] | type[AbstractWrapper]]] = {
    "rule": {
        "gradient": GradientRule,
        "search": SearchRule,
        "best_of": BestOfRule,
        "cross_entropy": CrossEntropyRule,
        "cma_es": CmaEsRule,
        "memory": MemoryRule,
        "none": NoAdaptation,
    },
    "then": {"trpo": ThenTrpo, "reinforce": ThenReinforce},
    "bonus": {"vime": VimeBonus},
}
"""Option of the command line -> the rules or wrappers that come with the library, by name."""


def from_text(option: str, text: str) -> Any:
    """Return the rule or wrapper that a text names: `NAME [SETTING=VALUE ...]`.

    NAME is one of `KNOWN[option]`, or `module:name` of a class of your own, which is imported. A
    setting of a setting is written with a dot, as in `curiosity.weight=0.001`.
    """
    name, *words = text.split() or [""]
    known = KNOWN[option]
    found = imported(name, option) if ":" in name else known.get(name)
    kind = AbstractRule if option == "rule" else AbstractWrapper
    if found is None:
        raise RunError(
            f"`{option}` must be one of {', '.join(known)}, or `module:name` of your own, got "
            f"`{name}`."
        )
    if not (isinstance(found, type) and issubclass(found, kind)):
        raise RunError(f"`{name}` must be a class that extends `maesn.{kind.__name__}`.")
    with refusals(f"`{option}` cannot be `{text}`: "):
        usual, values = found(), values_of_words(words)
        try:
            return replaced(usual, values)
        except KeyError as error:
            raise ValueError(
                f"it has no setting `{error.args[0]}`; write NAME=VALUE with one of "
                f"{', '.join(fields_to_json(usual))}."
            ) from error


def _read(
    number: int | Literal["*"],
    metavar: str,
    read: Callable[[list[str]], Any] = lambda words: words[0],
    written: Callable[[Any], list[str]] = lambda value: [str(value)],
) -> PrimitiveConstructorSpec[Any]:
    """Say how many words of the command line an argument is, and how they are read."""
    return PrimitiveConstructorSpec(number, metavar, read, lambda _: True, written)


def _named(option: str) -> PrimitiveConstructorSpec[Any]:
    """Say that an argument is the name of a rule or a wrapper, and its settings."""
    return _read(
        "*",
        option.upper(),
        lambda words: from_text(option, " ".join(words)) if words else None,
        lambda chosen: [] if chosen is None else [chosen.label],
    )


def _changes(words: list[str]) -> dict[str, Any]:
    with refusals("`--change`: "):
        return values_of_words(words)


AnyRun: TypeAlias = Annotated[str | Path | Run, _read(1, "RUN")]
"""A run, its directory, or the name of a policy that comes with the library."""
AnyPath: TypeAlias = Annotated[str | Path, _read(1, "PATH")]
OptionalPath: TypeAlias = Annotated[str | Path | None, _read(1, "PATH")]
AnyFamily: TypeAlias = Annotated[str | TaskFamily | None, _read(1, "MODULE:NAME")]
"""A user's own family or its `module:name`; None for one that comes with the library."""
AnyRule: TypeAlias = Annotated[AbstractRule | None, _named("rule")]
"""A rule, or on the command line its name and its settings."""
AnyChange: TypeAlias = Annotated[Mapping[str, Any] | None, _read("*", "NAME=VALUE", _changes)]
"""Name of a setting -> its new value."""
Flag: TypeAlias = Annotated[bool, _read(0, "", lambda _: True, lambda _: [])]
"""False, unless the command line names it; it takes no value there."""


@dataclasses.dataclass(frozen=True)
class _Options(Evaluation):
    """Options of the command line, to be checked when rule and wrappers are known as well."""

    def __post_init__(self) -> None:
        pass


def evaluation_from_text(
    options: Annotated[_Options, tyro.conf.arg(name="")],
    rule: AnyRule = None,
    then: Annotated[AbstractWrapper | None, _named("then")] = None,
    bonus: Annotated[AbstractWrapper | None, _named("bonus")] = None,
) -> Evaluation:
    """Return an evaluation with rule and wrappers that are given as words.

    Args:
        options: all else.
        rule: What happens in a new task: gradient, search, best_of, cross_entropy, cma_es, memory
            or none, or `module:name` of your own; behind it its settings, as in `--rule gradient
            step_scale=2`. Left out: what the method prescribes. `maesn list` has all settings.
        then: How the policy's weights go on after some episodes: trpo or reinforce, as in `--then
            trpo after=500 max_kl=0.01`. Left out: they stay.
        bonus: A bonus on the rewards that are learned from, as in `--bonus vime
            curiosity.weight=0.001`.
    """
    wrappers = tuple(one for one in (then, bonus) if one is not None)
    with refusals():
        return Evaluation(**vars(options) | {"rule": rule, "wrappers": wrappers})


AnyEvaluation: TypeAlias = Annotated[
    Evaluation, tyro.conf.arg(name="", constructor=evaluation_from_text)
]


def open_run(run: AnyRun, family: AnyFamily = None) -> Run:
    """Open a run whose directory will be written to; of a policy with the library, a copy."""
    opened = run if isinstance(run, Run) else Run.open(working_copy(run), family=family)
    refuse_links(opened.directory)
    return opened


@contextmanager
def new_tasks(
    run: Run, evaluation: Evaluation
) -> Iterator[tuple[AbstractWorld, AbstractFastLearner[Any]]]:
    """Open the world that a run is evaluated in, and say what learns there."""
    world = run.world(
        run.task_set(evaluation.tasks),
        evaluation.reward,
        evaluation.engine,
        sparse_radius=evaluation.sparse_radius,
        num_threads=evaluation.num_threads,
    )
    with closing(world):
        state = run.latest_state()
        check_policy(run.learner.player(state), world.env)
        trained = Trained(run.learner, state, partial(find_prior, run, state, world))
        yield world, evaluation.fast_learner(trained, run.settings.method, world.env)


def evaluate(
    run: Run,
    evaluation: Evaluation,
    start: Path | None = None,
    tasks: Sequence[int] | None = None,
) -> tuple[AdaptationOutcome, dict[str, Any]]:
    """Adapt a run to new tasks as `maesn.adapt` says; return the outcome, and its record.

    `tasks` are indices of some of them; None for all that `evaluation` says.
    """
    with new_tasks(run, evaluation) as (world, learner):
        saved = None if start is None else _saved_contexts(start, learner, len(world.tasks))
        outcome = play(world, learner, evaluation, saved, tasks)
        engine = evaluation.engine or run.settings.engine
        first = outcome.first_update
        record = adaptation_record(identity_of_run(run), world, engine, evaluation, first)
    return outcome, record | {"trial_episodes": outcome.trial_episodes}


def play(
    world: AbstractWorld,
    learner: AbstractFastLearner[Any],
    evaluation: Evaluation,
    saved: SavedContexts | None = None,
    tasks: Sequence[int] | None = None,
) -> AdaptationOutcome:
    """Adapt a fast learner in a world, with the budgets of an evaluation; see `evaluate`."""
    budget = evaluation.budget
    return adapt(
        learner,
        Collector(world, budget.per_update),
        episodes=budget.episodes,
        deploy=Collector(world, budget.deploy) if budget.deploy else None,
        deploy_after=evaluation.deploy_after,
        seed=evaluation.seed,
        chunk_size=evaluation.tasks_at_once,
        saved=saved,
        tasks=range(evaluation.count(world.tasks)) if tasks is None else tasks,
    )


def _saved_contexts(path: Path, learner: AbstractFastLearner[Any], num_tasks: int) -> SavedContexts:
    # A start at the prior has no use for keys.
    state = learner.init(jax.random.split(jax.random.key(0), num_tasks))
    wanted = learner.agents(state).context
    if not (learner.capabilities.resumes and isinstance(wanted, Latent)):
        raise RunError(
            f"`{path}` cannot be a start: the latents in it are not all that this method learns in "
            "a task."
        )
    latents, updates = read_latents(path)
    if latents.mean.shape != wanted.mean.shape:
        raise RunError(
            f"`{path}` holds latents of the shape [task, z] = {list(latents.mean.shape)}, but "
            f"{list(wanted.mean.shape)} are to be adapted: give the task set and the run of before."
        )
    return SavedContexts(latents, updates)
