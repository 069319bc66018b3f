"""How command lines are read: a command is a function, and tyro makes its parameters options."""

import contextlib
import functools
import inspect
import io
import re
import sys
from collections.abc import Callable
from typing import Any

import tyro
import tyro._strings

from maesn.evaluation.arguments import evaluation_from_text
from maesn.evaluation.evaluation import Evaluation
from maesn.runs.process import enable_compilation_cache
from maesn.settings import suggestion
from maesn.storage import refusals

# A union of settings keeps the preset's choice, and a boolean takes True or False: the options of
# a command then do not depend on the values of others.
_CONFIGURATION = (tyro.conf.AvoidSubcommands, tyro.conf.FlagConversionOff)

# What people call an option that has another name, where no option has that one.
_OTHER_NAMES = {
    "batch-size": "meta-batch-size",
    "env": "family",
    "environment": "family",
    "epochs": "iterations",
    "goals": "tasks",
    "latents": "start",
    "name": "run",
    "output": "out",
    "radius": "sparse-radius",
    "steps": "iterations",
    "threads": "num-threads",
    "updates": "episodes",
}


def _one_line_paragraphs(helptext: str) -> str:
    """Return a text without the line breaks inside of its paragraphs."""
    return "\n\n".join(" ".join(part.split()) for part in re.split(r"\n\s*\n", helptext))


def _one_line_arguments(function: Callable[..., Any]) -> str:
    """Return a docstring with each argument on one line; with paragraphs tyro does so."""
    return re.sub(r"\n {5,}", " ", inspect.getdoc(function) or "")


# tyro wraps help at the width of the terminal, but keeps most line breaks of docstrings.
tyro._strings.remove_single_line_breaks = _one_line_paragraphs  # noqa: SLF001
_CONSTRUCTOR = inspect.unwrap(evaluation_from_text)  # of the type checks in tests
_CONSTRUCTOR.__doc__ = _one_line_arguments(_CONSTRUCTOR)


def command(
    function: Callable[..., Any],
    show: Callable[[Any], None] = lambda _: None,
    name: str | None = None,
) -> Callable[[list[str]], None]:
    """Make a command of a function, and show what it returns.

    Its name is that of the command unless `name` says another. Its parameters are the options, its
    docstring is the help.
    """

    @functools.wraps(function)
    def bound(**options: Any) -> Callable[[], Any]:
        return functools.partial(function, **options)

    del bound.__wrapped__  # tyro would read its docstring
    bound.__doc__ = _one_line_arguments(function)
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
        show(run())

    return main


def parse(kind: Any, name: str, arguments: list[str], default: Any = tyro.MISSING_NONPROP) -> Any:
    """Build the dataclass `kind`, or call it, with a command's options; exit with 2 if wrong."""
    read = functools.partial(
        tyro.cli, kind, prog=f"maesn {name}", config=_CONFIGURATION, default=default
    )
    try:
        with refusals():  # of a setting that cannot be; tyro reports those of nested ones
            return read(args=arguments)
    except SystemExit as end:
        if end.code:
            shown = io.StringIO()
            with contextlib.redirect_stdout(shown), contextlib.suppress(SystemExit):
                read(args=["--help"])
            _suggest(arguments, re.findall(r"--([\w.-]+)", shown.getvalue()))
        raise


def _suggest(arguments: list[str], options: list[str]) -> None:
    """Print which options may have been meant by words that are none."""
    given = [word[2:].partition("=")[0].replace("_", "-") for word in arguments if word[:2] == "--"]
    for word in given:
        other = _OTHER_NAMES.get(word, "")
        if word not in options:
            hint = f" Did you mean `{other}`?" if other in options else suggestion(word, options)
            meant = hint.replace("`", "`--", 1)
            print(f"There is no option `--{word}`.{meant}", file=sys.stderr)
