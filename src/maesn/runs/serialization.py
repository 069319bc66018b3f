"""Settings as JSON: a learner goes into `config.json` and comes out the same.

Objects have a tag, `"type"`, that is looked up in a closed registry: a file can ask for nothing but
the settings listed here. What is unknown, missing or of the wrong type is a `ValueError`.
"""

import ast
import contextlib
import dataclasses
import hashlib
import json
import types
from collections.abc import Iterable, Mapping
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

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
        known = ", ".join(REGISTRY)
        raise ValueError(f"settings of type `{tag}` cannot be stored: only {known} can.")
    return {TAG: tag, **fields_to_json(module)}


def from_json(document: Mapping[str, Any]) -> eqx.Module:
    """Return the settings that `to_json` has written."""
    tag = document.get(TAG)
    if not isinstance(tag, str) or tag not in REGISTRY:
        raise ValueError(f"`{TAG}` must be one of {', '.join(REGISTRY)}, got {tag!r}.")
    fields = {name: value for name, value in document.items() if name != TAG}
    return fields_from_json(REGISTRY[tag], fields)


def digest(module: eqx.Module) -> str:
    """Return a hexadecimal hash of settings: equal if and only if they are."""
    return digest_of_document(to_json(module))


def digest_of_document(document: Mapping[str, Any]) -> str:
    """Return a hexadecimal hash of a JSON document."""
    text = json.dumps(document, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def differing(settings: Any, usual: Any) -> dict[str, Any]:
    """Return the values, by their path, in which settings differ from others of their class."""
    own, others = (leaves(fields_to_json(one)) for one in (settings, usual))
    return {path: value for path, value in own.items() if (path, value) not in others.items()}


def replaced(settings: Settings, changes: Mapping[str, Any]) -> Settings:
    """Return settings with other JSON values by their path; `KeyError` if there is no such path."""
    document = fields_to_json(settings)
    for path, value in changes.items():
        *parents, last = path.split(".")
        target: Any = document
        for parent in parents:
            target = target.get(parent) if isinstance(target, dict) else None
        if not isinstance(target, dict) or last == TAG or isinstance(target.get(last, {}), dict):
            raise KeyError(path)
        target[last] = value
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
    hints = get_type_hints(type(settings))
    return {
        field.name: _encode(getattr(settings, field.name), hints[field.name])
        for field in dataclasses.fields(settings)
    }


def fields_from_json(kind: type[Settings], document: Mapping[str, Any]) -> Settings:
    """Return the dataclass of settings that `fields_to_json` has written."""
    hints = get_type_hints(kind)
    names = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
    for complaint, wrong in (
        ("has no field", sorted(document.keys() - set(names))),
        ("lacks the field", sorted(set(names) - document.keys())),
    ):
        if wrong:
            raise ValueError(f"`{kind.__name__}` {complaint} `{wrong[0]}`; it has {names}.")
    return kind(
        **{name: decode(document[name], hints[name], f"{kind.__name__}.{name}") for name in names}
    )


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
    origin, decoded = get_origin(wanted), value
    if origin is tuple and isinstance(value, list):
        item = get_args(wanted)[0]
        return tuple(decode(one, item, f"{where}[{i}]") for i, one in enumerate(value))
    if origin is dict and isinstance(value, dict):
        item = get_args(wanted)[1]
        return {name: decode(one, item, f"{where}.{name}") for name, one in value.items()}
    if isinstance(value, dict):
        # Settings have a tag; of another dataclass the field tells the class.
        known = isinstance(wanted, type) and dataclasses.is_dataclass(wanted)
        untagged = known and not issubclass(wanted, eqx.Module)
        decoded = fields_from_json(wanted, value) if untagged else from_json(value)
    elif wanted is float and type(value) is int:
        decoded = float(value)
    if not _fits(decoded, wanted):
        name = wanted.__name__ if isinstance(wanted, type) else wanted
        raise ValueError(f"`{where}` must be of type {name}, got {value!r}.")
    return decoded


def _required(hint: Any) -> Any:
    """Return X for "X or None", and any other hint as it is."""
    if get_origin(hint) not in (Union, types.UnionType):
        return hint
    (inner,) = (argument for argument in get_args(hint) if argument is not type(None))
    return inner


def _fits(value: Any, hint: Any) -> bool:
    """Whether a decoded value is of the type that a field declares."""
    if get_origin(hint) is Literal:
        return value in get_args(hint)
    if isinstance(value, eqx.Module):
        return isinstance(value, get_origin(hint) or hint)
    return type(value) is hint  # not `isinstance`: True is no number of tasks
