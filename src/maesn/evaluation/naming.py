"""Rules as text: `gradient step_scale=2`, `trpo max_kl=0.02`, or a class of your own."""

from collections.abc import Mapping
from typing import Any

from maesn.evaluation.rules import (
    AbstractRule,
    AbstractThen,
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

RULES: dict[str, type[AbstractRule]] = {
    "gradient": GradientRule,
    "search": SearchRule,
    "memory": MemoryRule,
    "none": NoAdaptation,
}
"""The rules that come with the library, by name."""

THEN: dict[str, type[AbstractThen]] = {"trpo": ThenTrpo, "reinforce": ThenReinforce}
"""Ways to fine-tune a policy, by name."""

BONUSES: dict[str, type[AbstractWrapper]] = {"vime": VimeBonus}
"""Bonuses, by name."""


def rule_from_text(text: str) -> AbstractRule:
    """Return the rule that a text names: `NAME [SETTING=VALUE ...]`.

    Args:
        text: NAME is one of `RULES`, or `module:name` of a class of your own, which is imported.
            A setting of a setting is written with a dot, as in `curiosity.weight=0.001`.

    Raises:
        RunError: there is no such rule, or it has no such setting or value.
    """
    return _from_text(text, "rule", RULES, AbstractRule)


def then_from_text(text: str) -> AbstractWrapper:
    """Return the fine-tuning that a text names, one of `THEN` or your own; see `rule_from_text`."""
    return _from_text(text, "then", THEN, AbstractWrapper)


def bonus_from_text(text: str) -> AbstractWrapper:
    """Return the bonus that a text names, one of `BONUSES` or your own; see `rule_from_text`."""
    return _from_text(text, "bonus", BONUSES, AbstractWrapper)


def _from_text(text: str, option: str, known: Mapping[str, type[Any]], kind: type[Any]) -> Any:
    name, *words = text.split() or [""]
    found = imported(name, option) if ":" in name else known.get(name)
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
