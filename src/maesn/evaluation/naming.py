"""Rules as text: `gradient step_scale=2`, `trpo max_kl=0.02`, or a class of your own."""

import importlib
import json
from collections.abc import Mapping
from typing import Any, TypeVar

import equinox as eqx

from maesn.evaluation.rules import (
    BONUSES,
    RULES,
    THEN,
    AbstractRule,
    AbstractWrapper,
)
from maesn.runs.serialization import fields_from_json, fields_to_json
from maesn.storage import RunError

Part = TypeVar("Part", bound=eqx.Module)


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
    found = _own(name, option) if ":" in name else known.get(name)
    if found is None:
        raise RunError(
            f"`{option}` must be one of {', '.join(known)}, or `module:name` of your own, got "
            f"`{name}`."
        )
    if not (isinstance(found, type) and issubclass(found, kind)):
        raise RunError(f"`{name}` must be a class that extends `maesn.{kind.__name__}`.")
    try:
        return _with_settings(found, words)
    except ValueError as error:
        raise RunError(f"`{option}` cannot be `{text}`: {error}") from error


def _own(name: str, option: str) -> Any:
    """Import a user's own class. Never call this with what a file of a run says."""
    module, _, attribute = name.partition(":")
    try:
        return getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise RunError(
            f"`{option}` is `{name}`, but {error}: `module` must be importable (set PYTHONPATH to "
            "where it is) and `name` a class in it."
        ) from error


def _with_settings(kind: type[Part], words: list[str]) -> Part:
    """Build settings from their defaults and `NAME=VALUE` words."""
    document = fields_to_json(kind())
    for word in words:
        path, equals, value = word.partition("=")
        *above, name = path.split(".")
        target: Any = document
        for part in above:
            target = target.get(part) if isinstance(target, dict) else None
        if not equals or not isinstance(target, dict) or name not in target:
            raise ValueError(
                f"it has no setting `{path}`; write NAME=VALUE with one of {', '.join(document)}."
            )
        target[name] = _value(value)
    return fields_from_json(kind, document)


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text
