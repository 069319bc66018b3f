"""How command lines are read: a command is a function, and tyro makes its parameters options."""

import functools
import inspect
from collections.abc import Callable
from typing import Any

import tyro

from maesn.evaluation.evaluation import Evaluation
from maesn.runs.compilation import enable_compilation_cache
from maesn.storage import refusals

# A union of settings keeps the preset's choice, and a boolean takes True or False: the options of
# a command then do not depend on the values of others.
_CONFIGURATION = (tyro.conf.AvoidSubcommands, tyro.conf.FlagConversionOff)


def command(
    function: Callable[..., Any],
    show: Callable[[Any], None] | None = None,
    name: str | None = None,
) -> Callable[[list[str]], None]:
    """Make a command of a function, and show what it returns.

    Its name is that of the command unless `name` says another. Its parameters are the options, its
    docstring is the help.
    """

    @functools.wraps(function)
    def bound(*values: Any, **options: Any) -> Callable[[], Any]:
        return functools.partial(function, *values, **options)

    signature = inspect.signature(function)
    parameters = [
        # An evaluation is made by a constructor, which has defaults of its own.
        one.replace(default=one.empty) if isinstance(one.default, Evaluation) else one
        for one in signature.parameters.values()
        if one.kind is not one.VAR_KEYWORD
    ]
    bound.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]

    def main(arguments: list[str]) -> None:
        run = parse(bound, name or function.__name__, arguments)
        enable_compilation_cache()
        result = run()
        if show is not None:
            show(result)

    return main


def parse(kind: Any, name: str, arguments: list[str], default: Any = tyro.MISSING_NONPROP) -> Any:
    """Build the dataclass `kind`, or call it, with a command's options; exit with 2 if wrong."""
    with refusals():  # of a setting that cannot be; tyro reports those of nested ones
        return tyro.cli(
            kind, prog=f"maesn {name}", args=arguments, config=_CONFIGURATION, default=default
        )
