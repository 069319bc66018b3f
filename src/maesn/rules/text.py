"""Rules and wrappers as text: by name on a command line and in a study, in full in a record."""

import dataclasses
from typing import Any

from maesn.envs.sources import imported
from maesn.rules.base import AbstractRule, AbstractWrapper
from maesn.rules.prescribed import GradientRule, MemoryRule, NoAdaptation
from maesn.rules.search import SearchRule
from maesn.rules.strategies import BestOfRule, CmaEsRule, CrossEntropyRule
from maesn.rules.wrappers import ThenReinforce, ThenTrpo, VimeBonus
from maesn.runs.serialization import fields_to_json, replaced, values_of_words
from maesn.storage import RunError, refusals

KNOWN: dict[str, dict[str, type[AbstractRule] | type[AbstractWrapper]]] = {
    "rule": {
        "gradient": GradientRule,
        "search": SearchRule,
        "best_of": BestOfRule,
        "cross_entropy": CrossEntropyRule,
        "cma_es": CmaEsRule,
        "memory": MemoryRule,
        "none": NoAdaptation,
    },
    "then": {"trpo": ThenTrpo, "reinforce": ThenReinforce},
    "bonus": {"vime": VimeBonus},
}
"""Option of the command line -> the rules or wrappers that come with the library, by name."""


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
            f"`{name}`."
        )
    if not (isinstance(found, type) and issubclass(found, kind)):
        raise RunError(f"`{name}` must be a class that extends `maesn.{kind.__name__}`.")
    with refusals(f"`{option}` cannot be `{text}`: "):
        usual, values = found(), values_of_words(words)
        try:
            return replaced(usual, values)
        except KeyError as error:
            raise ValueError(
                f"it has no setting `{error.args[0]}`; write NAME=VALUE with one of "
                f"{', '.join(fields_to_json(usual))}."
            ) from error


def written_out(settings: Any) -> str:
    """Write settings out in full, defaults as well: in a later version they may be others."""
    if not dataclasses.is_dataclass(settings):
        return repr(settings)
    values = (
        f"{field.name}={written_out(getattr(settings, field.name))}"
        for field in dataclasses.fields(settings)
    )
    kind = type(settings)
    own = "" if kind.__module__.startswith("maesn.") else f"{kind.__module__}:"
    return f"{own}{kind.__name__}({', '.join(values)})"
