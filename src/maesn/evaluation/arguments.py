"""Types of the verbs' arguments, which say as well how the command line reads them.

Rules are text there, such as `gradient step_scale=2`, or a class of your own.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from maesn.envs import TaskFamily
from maesn.rules import AbstractRule, AbstractWrapper, from_text
from maesn.runs.run import Run
from maesn.runtime.safeguards import Limit


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


def _limit(words: list[str]) -> Limit:
    if not words:
        raise ValueError("give one number, or one for each actuator")
    numbers = [float(word) for word in words]
    return numbers if numbers[1:] else numbers[0]


AnyRun: TypeAlias = Annotated[str | Path | Run, _read(1, "RUN")]
"""A run, its directory, or the name of a policy that comes with the library."""
AnyPath: TypeAlias = Annotated[str | Path, _read(1, "PATH")]
OptionalPath: TypeAlias = Annotated[str | Path | None, _read(1, "PATH")]
AnyFamily: TypeAlias = Annotated[str | TaskFamily | None, _read(1, "MODULE:NAME")]
"""A user's own family or its `module:name`; None for one that comes with the library."""
AnyMethod: TypeAlias = Annotated[str | None, _read(1, "MODULE:NAME")]
"""`module:name` of a user's own method; None for one that comes with the library."""
AnyRule: TypeAlias = Annotated[AbstractRule | None, _named("rule")]
"""A rule, or on the command line its name and its settings."""
AnyLimit: TypeAlias = Annotated[Limit | None, _read("*", "NUMBER", _limit)]
"""Limit of all actuators, or of each."""
Flag: TypeAlias = Annotated[bool, _read(0, "", lambda _: True, lambda _: [])]
"""False, unless the command line names it; it takes no value there."""


def _wrappers(
    then: Annotated[AbstractWrapper | None, _named("then")] = None,
    bonus: Annotated[AbstractWrapper | None, _named("bonus")] = None,
) -> tuple[AbstractWrapper, ...]:
    """Return what the command line adds to a rule.

    Args:
        then: Fine-tuning of the weights, as in `--then trpo after=500`.
        bonus: A bonus on the rewards, as in `--bonus vime curiosity.weight=0.001`.
    """
    return tuple(one for one in (then, bonus) if one is not None)


AnyWrappers: TypeAlias = Annotated[
    tuple[AbstractWrapper, ...], tyro.conf.arg(name="", constructor=_wrappers)
]
"""Additions to a rule: on the command line one of each kind, by its name and its settings."""
