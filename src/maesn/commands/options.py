"""How command lines are read: a command is a function, and tyro makes its parameters options."""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import tyro

from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.naming import bonus_from_text, rule_from_text, then_from_text
from maesn.runs.compilation import enable_compilation_cache
from maesn.storage import refusals

# A union of settings keeps the preset's choice, and a boolean takes True or False: the options of
# a command then do not depend on the values of others.
_CONFIGURATION = (tyro.conf.AvoidSubcommands, tyro.conf.FlagConversionOff)

TrainedRun: TypeAlias = tyro.conf.Positional[
    Annotated[
        Path,
        tyro.conf.arg(
            help="Directory of the run, whose last checkpoint is used, or the name of a policy "
            "that comes with the library (`maesn list`). A directory of that name in the current "
            "folder wins. What is written into the run of such a policy goes to `maesn-NAME` "
            "there, a run directory like any other."
        ),
    ]
]
OwnFamily: TypeAlias = Annotated[
    str | None, tyro.conf.arg(help="The run's family as `module:name`, if it is your own.")
]
Oracle: TypeAlias = Annotated[
    Path | None,
    tyro.conf.arg(
        help="Directory of a run of the preset `oracle`, the ceiling of the score; None: no score."
    ),
]


@dataclasses.dataclass(frozen=True)
class EvaluationOptions:
    """An evaluation, with its rule as text."""

    evaluation: Annotated[Evaluation, tyro.conf.arg(name="")] = Evaluation()
    rule: tuple[str, ...] = ()
    """What happens in a new task: gradient, memory or none, or `module:name` of your own; behind it
    its settings, as in `--rule gradient step_scale=2`. Left out: what the method prescribes. `maesn
    list` has all settings."""
    then: tuple[str, ...] = ()
    """How the policy's weights go on after some episodes: trpo or reinforce, as in `--then trpo
    after=500 max_kl=0.01`. Left out: they stay."""
    bonus: tuple[str, ...] = ()
    """A bonus on the rewards that are learned from, as in `--bonus vime curiosity.weight=0.001`."""

    def build(self) -> Evaluation:
        """Return the evaluation.

        Raises:
            RunError: a rule cannot be had, or not with these budgets.
        """
        rule = rule_from_text(" ".join(self.rule)) if self.rule else None
        wrappers = [then_from_text(" ".join(self.then))] if self.then else []
        wrappers += [bonus_from_text(" ".join(self.bonus))] if self.bonus else []
        with refusals():
            return dataclasses.replace(self.evaluation, rule=rule, wrappers=tuple(wrappers))


AnyEvaluation: TypeAlias = Annotated[EvaluationOptions, tyro.conf.arg(name="")]


def command(function: Callable[..., None]) -> Callable[[list[str]], None]:
    """Make a command of a function: its parameters are the options, its docstring the help."""

    @functools.wraps(function)
    def bound(*values: Any, **options: Any) -> Callable[[], None]:
        return functools.partial(function, *values, **options)

    def main(arguments: list[str]) -> None:
        run = parse(bound, function.__name__, arguments)
        enable_compilation_cache()
        run()

    return main


def parse(kind: Any, name: str, arguments: list[str], default: Any = tyro.MISSING_NONPROP) -> Any:
    """Build the options of a command; exits with code 2 if they are wrong.

    Args:
        kind: dataclass or function whose fields or parameters are the options.
        name: of the command, for the help text.
        arguments: what stands behind the command.
        default: values of the options that are not given.
    """
    with refusals():  # of a setting that cannot be; tyro reports those of nested ones
        return tyro.cli(
            kind, prog=f"maesn {name}", args=arguments, config=_CONFIGURATION, default=default
        )
