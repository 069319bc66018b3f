"""What settings have in common: how they are checked, and how they grow."""

import dataclasses
from typing import Any, get_args

_ADDED = "maesn: added later"


def check_choice(name: str, value: str, choices: Any) -> None:
    """Refuse what is not among the choices: misspelt, it would silently count as another one.

    Args:
        name: of the setting.
        value: what it was given.
        choices: a `Literal`.

    Raises:
        ValueError: it is not one of them.
    """
    if value not in get_args(choices):
        known = " or ".join(map(repr, get_args(choices)))
        raise ValueError(f"`{name}` must be {known}, got {value!r}.")


def added_later(default: Any) -> Any:
    """Return a field of settings that did not exist when files were first written.

    At its default it is left out of files, digests and records of curves, so what was written
    before it existed still says the same, and is still recognised. Its default therefore has to be
    what was done before, and must never change.

    Args:
        default: of the field.
    """
    return dataclasses.field(default=default, metadata={_ADDED: True})


def is_left_out(field: "dataclasses.Field[Any]", value: Any) -> bool:
    """Whether a value of a field is not written down."""
    return _ADDED in field.metadata and value == field.default


def may_be_missing(field: "dataclasses.Field[Any]") -> bool:
    """Whether a file need not say the value of a field."""
    return _ADDED in field.metadata
