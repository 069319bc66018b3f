"""How settings grow without making older files unreadable."""

import dataclasses
from typing import Any

_ADDED = "maesn: added later"


def added_later(default: Any) -> Any:
    """Return a field of settings that did not exist when files were first written.

    At its default it is left out of files and digests, so what was written before it existed still
    says the same, and is still recognised. Its default therefore has to be what was done before,
    and must never change.

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
