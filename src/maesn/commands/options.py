"""How command lines are read: typed objects from flags, by tyro."""

from typing import TypeVar

import tyro

from maesn.storage import refusals

Options = TypeVar("Options")

# A union of settings keeps the preset's choice, and a boolean takes True or False: the options of
# a command then do not depend on the values of others.
_CONFIGURATION = (tyro.conf.AvoidSubcommands, tyro.conf.FlagConversionOff)


def parse(
    options_class: type[Options],
    command: str,
    arguments: list[str],
    default: Options | None = None,
) -> Options:
    """Build the options of a command; exits with code 2 if they are wrong.

    Args:
        options_class: dataclass whose fields are the options.
        command: its name, for the help text.
        arguments: what stands behind the command.
        default: values of the options that are not given.
    """
    with refusals():  # of a setting that cannot be; tyro reports those of nested ones
        return tyro.cli(
            options_class,
            prog=f"maesn {command}",
            args=arguments,
            config=_CONFIGURATION,
            default=tyro.MISSING_NONPROP if default is None else default,
        )
