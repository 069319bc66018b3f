"""Settings as JSON: a learner goes into `config.json` and comes out the same.

Objects have a tag, `"type"`. A file can ask for nothing but settings that fit their field, of this
library or of a module that the program has imported already: reading imports nothing. What is
unknown, missing or of the wrong type is a `ValueError`.
"""

import ast
import contextlib
import dataclasses
import functools
import hashlib
import inspect
import itertools
import json
import sys
from collections.abc import Iterable, Mapping
from types import NoneType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import equinox as eqx

from maesn.settings import check_choice, leaves
from maesn.storage import RunError

Settings = TypeVar("Settings")

TAG = "type"


class UnknownTypeError(RunError):
    """A document names a type of a module that nobody has imported.

    Attributes:
        tag: `module:name` of the type.
    """

    def __init__(self, tag: str) -> None:
        super().__init__(f"it holds a `{tag}`, and reading a file never imports a module.")
        self.tag = tag


def tag_of(kind: type) -> str:
    """Return how files call a type: by its name in this library, by `module:name` elsewhere."""
    own = kind.__module__.split(".")[0] != "maesn"
    return f"{kind.__module__}:{kind.__qualname__}" if own else kind.__name__


def to_json(module: eqx.Module) -> dict[str, Any]:
    """Return settings as JSON values, each object with its tag."""
    tag = tag_of(type(module))
    if ":" in tag and _tagged(tag, eqx.Module) is not type(module):
        raise ValueError(f"settings of type `{tag}` must stand at the top of their module.")
    return {TAG: tag, **fields_to_json(module)}


def own_type(settings: eqx.Module) -> str | None:
    """Return the first type in settings that a user has brought, as `module:name`, if any."""
    found = leaves(to_json(settings)).items()
    tags = (str(value) for path, value in found if path.split(".")[-1] == TAG)
    return next((tag for tag in tags if ":" in tag), None)


def from_json(document: Mapping[str, Any], kind: type) -> Any:
    """Return the settings that `to_json` has written, of a type that extends `kind`."""
    fields = dict(document)
    return fields_from_json(_tagged(fields.pop(TAG, None), kind), fields)


def _tagged(tag: Any, kind: type) -> type:
    """Return the type that a tag names, which must extend `kind`. Nothing is imported."""
    found: Any
    if isinstance(tag, str) and ":" in tag:
        module, _, name = tag.partition(":")
        if module not in sys.modules:
            raise UnknownTypeError(tag)
        found = getattr(sys.modules[module], name, None)
    else:
        found = next((one for one in _extensions(kind) if tag_of(one) == tag), None)
    is_settings = isinstance(found, type) and issubclass(found, eqx.Module)
    if is_settings and issubclass(found, kind) and not inspect.isabstract(found):
        return found
    raise ValueError(f"`{TAG}` must name settings of type {kind.__name__}, got {tag!r}.")


def _extensions(kind: type) -> list[type]:
    extensions: list[type] = kind.__subclasses__()
    return [kind, *itertools.chain.from_iterable(map(_extensions, extensions))]


def digest_of_document(document: Mapping[str, Any]) -> str:
    """Return a hexadecimal hash of a JSON document."""
    text = json.dumps(document, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def replaced(settings: Settings, changes: Mapping[str, Any]) -> Settings:
    """Return settings with other JSON values by their path; `KeyError` if there is no such path.

    The path `SLOT.type` fills a slot with settings of another type, at their defaults. It is a
    `ValueError` if these have none.
    """
    document = fields_to_json(settings)
    # A type brings the slots inside of it.
    order = sorted(changes, key=lambda path: (not path.endswith(f".{TAG}"), path.count(".")))
    for path, value in ((path, changes[path]) for path in order):
        if path not in leaves(document):
            raise KeyError(path)
        *parents, last = path.split(".")
        slot = functools.reduce(dict.__getitem__, parents, document)
        if last == TAG and value != slot[TAG]:
            kind = _tagged(value, eqx.Module)
            try:
                default = kind()
            except TypeError as error:
                raise ValueError(f"`{path}`: `{value}` has no defaults.") from error
            slot.clear()
            slot.update(to_json(default))
        else:
            slot[last] = value
    return fields_from_json(type(settings), document)


def values_of_words(words: Iterable[str]) -> dict[str, Any]:
    """Return what words as `outer.trust_region.damping=0.1` say: path -> value."""
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
    if isinstance(value, dict) and isinstance(origin, type) and dataclasses.is_dataclass(origin):
        # Settings have a tag; of another dataclass the field tells the class.
        tagged = issubclass(origin, eqx.Module)
        return from_json(value, origin) if tagged else fields_from_json(origin, value)
    if origin is Literal:
        check_choice(where, value, wanted)
    if origin is Literal or type(value) is origin:
        return value  # `type`, not `isinstance`: True is no number of tasks
    if origin is float and type(value) is int:
        return float(value)
    name = wanted.__name__ if isinstance(wanted, type) else wanted
    raise ValueError(f"`{where}` must be of type {name}, got {value!r}.")


def _required(hint: Any) -> Any:
    """Return X for "X or None", and any other hint as it is."""
    others = [one for one in get_args(hint) if one is not NoneType]
    return others[0] if NoneType in get_args(hint) else hint
