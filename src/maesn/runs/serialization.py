"""Settings as JSON: a learner goes into `config.json` and comes out the same.

Objects have a tag, `"type"`, that is looked up in a closed registry: a file can ask for nothing but
the settings listed here. What is unknown, missing or of the wrong type is a `ValueError`.
"""

import ast
import contextlib
import dataclasses
import functools
import hashlib
import json
from collections.abc import Iterable, Mapping
from types import NoneType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import equinox as eqx

from maesn import learners
from maesn.context import BiasContext, LatentContext, NoContext, OracleContext
from maesn.inner.adaptation import Adaptation, InnerStep, StepSchedule
from maesn.inner.advantage import AdvantageEstimator
from maesn.numerics import MinibatchDescent
from maesn.numerics.trust_region import TrustRegion
from maesn.policies import AnnealedGaussianMLP, CategoricalMLP, GaussianMLP, Recurrent
from maesn.settings import leaves

Settings = TypeVar("Settings")

TAG = "type"

REGISTRY: dict[str, type[eqx.Module]] = {
    settings.__name__: settings
    for settings in (
        Adaptation,
        AdvantageEstimator,
        AnnealedGaussianMLP,
        BiasContext,
        CategoricalMLP,
        learners.BonusMetaLearner,
        learners.CuriosityBonus,
        GaussianMLP,
        learners.GradientMetaLearner,
        InnerStep,
        LatentContext,
        MinibatchDescent,
        NoContext,
        learners.ProximalStep,
        Recurrent,
        learners.RecurrentMetaLearner,
        learners.RecurrentValue,
        StepSchedule,
        OracleContext,
        TrustRegion,
        learners.TrustRegionStep,
    )
}


def to_json(module: eqx.Module) -> dict[str, Any]:
    """Return settings as JSON values, each object with its tag."""
    tag = type(module).__name__
    if REGISTRY.get(tag) is not type(module):
        raise ValueError(f"settings of type `{tag}` cannot be stored: only {[*REGISTRY]} can.")
    return {TAG: tag, **fields_to_json(module)}


def from_json(document: Mapping[str, Any]) -> eqx.Module:
    """Return the settings that `to_json` has written."""
    fields = dict(document)
    tag = fields.pop(TAG, None)
    if not isinstance(tag, str) or tag not in REGISTRY:
        raise ValueError(f"`{TAG}` must be one of {[*REGISTRY]}, got {tag!r}.")
    return fields_from_json(REGISTRY[tag], fields)


def digest_of_document(document: Mapping[str, Any]) -> str:
    """Return a hexadecimal hash of a JSON document."""
    text = json.dumps(document, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def replaced(settings: Settings, changes: Mapping[str, Any]) -> Settings:
    """Return settings with other JSON values by their path; `KeyError` if there is no such path."""
    document = fields_to_json(settings)
    known = leaves(document)
    for path, value in changes.items():
        *parents, last = path.split(".")
        if path not in known or last == TAG:
            raise KeyError(path)
        functools.reduce(dict.__getitem__, parents, document)[last] = value
    return fields_from_json(type(settings), document)


def values_of_words(words: Iterable[str]) -> dict[str, Any]:
    """Return what words as `trust_region.damping=0.1` say: path -> value."""
    values: dict[str, Any] = {}
    for word in words:
        path, equals, text = word.partition("=")
        path = path.replace("-", "_")
        if not (path and equals) or path in values:
            raise ValueError(f"expected NAME=VALUE, each name once, got `{word}`.")
        values[path] = text
        # Literals alone: numbers, truth values, None, lists.
        for read in (ast.literal_eval, json.loads):
            with contextlib.suppress(ValueError, SyntaxError, TypeError, MemoryError):
                values[path] = read(text)
    return values


def fields_to_json(settings: Any) -> dict[str, Any]:
    """Return the fields of any dataclass of settings as JSON values."""
    hints = _hints(type(settings)).items()
    return {name: _encode(getattr(settings, name), hint) for name, hint in hints}


def fields_from_json(kind: type[Settings], document: Mapping[str, Any]) -> Settings:
    """Return the dataclass of settings that `fields_to_json` has written."""
    hints, title = _hints(kind), kind.__name__
    if document.keys() != hints.keys():
        raise ValueError(f"`{title}` must have the fields {[*hints]}, got {[*document]}.")
    return kind(**{n: decode(document[n], hint, f"{title}.{n}") for n, hint in hints.items()})


def _hints(kind: Any) -> dict[str, Any]:
    """Return the types of a dataclass's fields."""
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _encode(value: Any, hint: Any) -> Any:
    if isinstance(value, eqx.Module):
        return to_json(value)
    if isinstance(value, tuple):
        return [_encode(item, get_args(hint)[0]) for item in value]
    if dataclasses.is_dataclass(value):
        return fields_to_json(value)
    # So that 1 and 1.0, which are equal, are the same document.
    return float(value) if _required(hint) is float and value is not None else value


def decode(value: Any, hint: Any, where: str) -> Any:
    """Return a JSON value as what a field, `Class.field`, declares."""
    wanted = _required(hint)
    if wanted is Any or (value is None and wanted is not hint):
        return value
    origin, arguments = get_origin(wanted) or wanted, get_args(wanted)
    if origin is tuple and isinstance(value, list):
        return tuple(decode(one, arguments[0], f"{where}[{i}]") for i, one in enumerate(value))
    if origin is dict and isinstance(value, dict):
        return {name: decode(one, arguments[1], f"{where}.{name}") for name, one in value.items()}
    if isinstance(value, dict) and isinstance(origin, type):
        # Settings have a tag; of another dataclass the field tells the class.
        tagged = not dataclasses.is_dataclass(origin) or issubclass(origin, eqx.Module)
        made = from_json(value) if tagged else fields_from_json(origin, value)
        if isinstance(made, origin):
            return made
    elif (origin is Literal and value in arguments) or type(value) is origin:
        return value  # `type`, not `isinstance`: True is no number of tasks
    elif origin is float and type(value) is int:
        return float(value)
    name = wanted.__name__ if isinstance(wanted, type) else wanted
    raise ValueError(f"`{where}` must be of type {name}, got {value!r}.")


def _required(hint: Any) -> Any:
    """Return X for "X or None", and any other hint as it is."""
    others = [one for one in get_args(hint) if one is not NoneType]
    return others[0] if NoneType in get_args(hint) else hint
