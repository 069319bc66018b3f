"""Rules as text: `gradient step_scale=2`, `trpo max_kl=0.02`, or a class of your own."""

from typing import Any

from maesn.evaluation.rules import (
    AbstractRule,
    AbstractWrapper,
    GradientRule,
    MemoryRule,
    NoAdaptation,
    ThenReinforce,
    ThenTrpo,
    VimeBonus,
)
from maesn.evaluation.search import SearchRule
from maesn.runs.serialization import fields_to_json, replaced, values_of_words
from maesn.runs.sources import imported
from maesn.storage import RunError, refusals

KNOWN: dict[str, dict[str, type[AbstractRule] | type[AbstractWrapper]]] = {
    "rule": {
        "gradient": GradientRule,
        "search": SearchRule,
        "memory": MemoryRule,
        "none": NoAdaptation,
    },
    "then": {"trpo": ThenTrpo, "reinforce": ThenReinforce},
    "bonus": {"vime": VimeBonus},
}
"""Option of the command line -> the rules or wrappers that come with the library, by name."""


def from_text(option: str, text: str) -> Any:
    """Return the rule or wrapper that a text names: `NAME [SETTING=VALUE ...]`.

    Args:
        option: rule, then for fine-tuning, or bonus.
        text: NAME is one of `KNOWN[option]`, or `module:name` of a class of your own, which is
            imported. A setting of a setting is written with a dot, as in `curiosity.weight=0.001`.

    Raises:
        RunError: there is no such class, or it has no such setting or value.
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
