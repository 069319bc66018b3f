"""Command lines: a command is a function, and tyro makes its parameters options."""

import argparse
import functools
import inspect
import re
from collections.abc import Callable
from typing import Any

import tyro
import tyro._strings

from maesn.evaluation.evaluation import Evaluation
from maesn.runs.process import enable_compilation_cache
from maesn.storage import refusals

# A union of settings keeps the preset's choice, and a boolean takes True or False: the options of
# a command then do not depend on the values of others.
_CONFIGURATION = (tyro.conf.AvoidSubcommands, tyro.conf.FlagConversionOff)


def _one_line_paragraphs(helptext: str) -> str:
    """Return a text without the line breaks inside of its paragraphs."""
    return "\n\n".join(" ".join(part.split()) for part in re.split(r"\n\s*\n", helptext))


# tyro wraps help at the width of the terminal, but keeps most line breaks of docstrings.
tyro._strings.remove_single_line_breaks = _one_line_paragraphs  # noqa: SLF001


def command(
    function: Callable[..., Any],
    show: Callable[[Any], None] = lambda _: None,
    name: str = "",
    **defaults: Any,
) -> Callable[[list[str]], None]:
    """Make a command of a function, and show what it returns.

    Its parameters are the options, its docstring is the help. `defaults` take the place of its own,
    and their options come first; `--protocol` decides the defaults of an evaluation. Messages call
    the command by `name`, if not by that of the function.
    """

    @functools.wraps(function)
    def bound(**options: Any) -> Callable[[], Any]:
        return functools.partial(function, **options)

    del bound.__wrapped__  # tyro would read its docstring
    bound.__doc__ = re.sub(r"\n {5,}", " ", inspect.getdoc(function) or "")  # each argument a line
    signature = inspect.signature(function)
    listed = {one: signature.parameters[one] for one in defaults} | signature.parameters
    named = [
        one.replace(default=defaults.get(one.name, one.default))
        for one in listed.values()
        if one.kind is not one.VAR_KEYWORD
    ]

    def main(arguments: list[str]) -> None:
        suited = [_by_protocol(one, arguments) for one in named]
        bound.__signature__ = signature.replace(parameters=suited)  # type: ignore[attr-defined]
        with refusals():  # of a setting that cannot be; tyro reports those of nested ones
            run = tyro.cli(
                bound,
                prog=f"maesn {name or function.__name__}",
                args=arguments,
                config=_CONFIGURATION,
            )
        enable_compilation_cache()
        show(run())

    return main


def _by_protocol(parameter: inspect.Parameter, arguments: list[str]) -> inspect.Parameter:
    """Return a parameter whose default, if it is an evaluation, is by the protocol, if any."""
    name, usual = read_first(arguments, "protocol")[0].protocol, parameter.default
    if name is None or not isinstance(usual, Evaluation):
        return parameter
    return parameter.replace(default=usual.changed(protocol=name))


def read_first(arguments: list[str], *names: str) -> tuple[argparse.Namespace, list[str]]:
    """Return options that decide about others, and all arguments but these; "" has no value."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    for name in names:
        parser.add_argument(f"--{name}", nargs="?", const="")
    return parser.parse_known_args(arguments)
