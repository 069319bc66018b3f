"""Rules and wrappers as text: by name on a command line and in a study, in full in a record."""

import dataclasses
from collections.abc import Iterator
from typing import Any

from maesn.envs.sources import imported
from maesn.rules.base import AbstractRule, AbstractWrapper
from maesn.rules.prescribed import GradientRule, NoAdaptation
from maesn.rules.search import SearchRule, StationaryRule
from maesn.rules.wrappers import ThenTrpo, VimeBonus
from maesn.serialization import TAG, fields_to_json, replaced, values_of_words
from maesn.settings import leaves, suggestion
from maesn.storage import RunError, refusals

KNOWN: dict[str, dict[str, type[AbstractRule] | type[AbstractWrapper]]] = {
    "rule": {
        "gradient": GradientRule,
        "search": SearchRule,
        "none": NoAdaptation,
        "stationary": StationaryRule,
    },
    "then": {"trpo": ThenTrpo},
    "bonus": {"vime": VimeBonus},
}
"""Option of the command line -> the rules or wrappers that come with the library, by name."""

_IN_PLACE = "settings"  # the field whose own fields are written in its place


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
            f"`{name}`.{suggestion(name, known)}"
        )
    if not (isinstance(found, type) and issubclass(found, kind)):
        raise RunError(f"`{name}` must be a class that extends `maesn.{kind.__name__}`.")
    with refusals(f"`{option}` cannot be `{text}`: "):
        usual, values = found(), values_of_words(words)
        paths = paths_of(usual)
        if unknown := [name for name in values if name not in paths]:
            raise ValueError(
                f"it has no setting `{unknown[0]}`; write NAME=VALUE with one of "
                f"{', '.join(paths)}."
            )
        return replaced(usual, {paths[name]: value for name, value in values.items()})


def paths_of(rule: AbstractRule | AbstractWrapper) -> dict[str, str]:
    """Return the names of a rule's settings, as they are written behind its own: name -> path."""
    paths = (path for path in leaves(fields_to_json(rule)) if path.split(".")[-1] != TAG)
    return {path.removeprefix(f"{_IN_PLACE}."): path for path in paths}


def written_out(settings: Any) -> str:
    """Write settings out in full, defaults as well: in a later version they may be others."""
    if not dataclasses.is_dataclass(settings):
        return repr(settings)
    values = (f"{name}={written_out(value)}" for name, value in _fields(settings))
    kind = type(settings)
    own = "" if kind.__module__.startswith("maesn.") else f"{kind.__module__}:"
    return f"{own}{kind.__name__}({', '.join(values)})"


def _fields(settings: Any) -> Iterator[tuple[str, Any]]:
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if field.name == _IN_PLACE and dataclasses.is_dataclass(value):
            yield from _fields(value)
        else:
            yield field.name, value
