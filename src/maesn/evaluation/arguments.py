"""Types of the verbs' arguments, which say as well how the command line reads them.

Rules are text there, such as `gradient step_scale=2`, or a class of your own.
"""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from maesn.envs import TaskFamily
from maesn.evaluation.evaluation import Evaluation
from maesn.rules import AbstractRule, AbstractWrapper, from_text
from maesn.runs.run import Run
from maesn.runs.serialization import values_of_words
from maesn.storage import refusals


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
