"""Environments written down, so that a changed default in code cannot change an existing run.

`describe_env` returns what decides an environment's numbers, as JSON values. `rebuild_env` makes
the environment again, and refuses one that has become another. Settings, constants of the class and
the text of a MuJoCo model are recorded; the code of functions is not.
"""

import dataclasses
import hashlib
import inspect
import math
from collections.abc import Iterator
from typing import Any, TypeAlias

import jax
import numpy as np

from maesn.envs.base import AbstractMujocoEnv, AnyEnv
from maesn.envs.tasks import TaskFamily
from maesn.physics.digest import model_digest

EnvRecord: TypeAlias = dict[str, Any]
"""Name -> JSON value. The parts of a nested dataclass are named `field.part`."""

# What `TaskFamily.make_env` is called with.
_FAMILY_SETTINGS = ("variant", "reward_kind", "sparse_radius")
# These name things or are for figures; the model is recorded by its digest, and the last one is
# set by `typing.Generic`.
_LEFT_OUT = ("name", "engine", "planar", "model", "_is_protocol")
_MODEL_DIGEST = "model_digest"
_CONSTANTS = (bool, int, float, str, tuple, np.ndarray, np.generic)
_MISSING = object()


def describe_env(env: AnyEnv) -> EnvRecord:
    """Return what decides the environment's numbers, as JSON values by name.

    These are all fields of the environment and all attributes of its class that are numbers,
    strings, booleans, None, or tuples or dataclasses of these (`horizon`, `sparse_radius`,
    `control_period`, ...); arrays by their digest; and `model_digest` of a MuJoCo model. Infinite
    numbers and NaN are written as text. Functions are left out.

    Args:
        env: of whatever family.

    Raises:
        FileNotFoundError: its MuJoCo model is missing.
    """
    record: EnvRecord = {}
    for name in _attributes(type(env)):
        record |= _plain(name, getattr(env, name, None))
    if isinstance(env, AbstractMujocoEnv):
        record[_MODEL_DIGEST] = model_digest(env.model)
    return record


def rebuild_env(family: TaskFamily, recorded: EnvRecord, **overrides: Any) -> AnyEnv:
    """Return the environment that was recorded, whatever the family's defaults are today.

    Args:
        family: that the recorded environment belongs to.
        recorded: what `describe_env` returned, possibly read from JSON.
        overrides: fields that are to differ from the record, such as `reward_kind`.

    Raises:
        ValueError: a constant of the environment or its model is not what was recorded, or a
            recorded or overriding value cannot be used.
        FileNotFoundError: its MuJoCo model is missing.
    """
    try:
        env = _with_fields(_from_family(family, recorded | overrides), recorded, overrides)
    except TypeError as error:
        raise ValueError(f"`{family.name}` cannot be made as recorded: {error}") from error
    _check_equal(env, recorded, tuple(overrides))
    return env


def _attributes(kind: type[AnyEnv]) -> Iterator[str]:
    """Yield the names of all fields and class attributes, each once; not those of methods."""
    names: dict[str, None] = {}
    for base in reversed(kind.__mro__):
        names |= dict.fromkeys(inspect.get_annotations(base))
        names |= {name: None for name, value in vars(base).items() if isinstance(value, _CONSTANTS)}
    for name in names:
        if not name.startswith("__") and name not in _LEFT_OUT:
            yield name


def _plain(name: str, value: Any) -> EnvRecord:
    """Return a value as JSON values under its name; nothing if it cannot be written down."""
    if dataclasses.is_dataclass(value):
        parts = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        plain = {key: _plain(f"{name}.{key}", part) for key, part in parts.items()}
        if not all(plain.values()):  # functions belong to it: it does more than to hold numbers
            return {}
        return {key: part for found in plain.values() for key, part in found.items()}
    try:
        return {name: _json(value)}
    except TypeError:
        return {}


def _json(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return str(float(value))
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, tuple | list):
        return [_json(part) for part in value]
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        array = np.ascontiguousarray(value)
        content = f"{array.dtype.str}{array.shape}".encode() + array.tobytes()
        return hashlib.sha256(content).hexdigest()[:16]
    raise TypeError


def _from_family(family: TaskFamily, wanted: EnvRecord) -> AnyEnv:
    """Return the family's environment with those settings that a family can be asked for."""
    own = family.make_env()
    settings = {
        name: wanted[name]
        for name in _FAMILY_SETTINGS
        if name in wanted and wanted[name] != _json(getattr(own, name))
    }
    return family.make_env(**settings) if settings else own


def _with_fields(env: AnyEnv, recorded: EnvRecord, overrides: EnvRecord) -> AnyEnv:
    """Return the environment with the recorded and then the overriding values of its fields."""
    own = {field.name: getattr(env, field.name) for field in dataclasses.fields(env) if field.init}
    unknown = [name for name in overrides if name not in own]
    if unknown:
        raise ValueError(
            f"`{unknown[0]}` is not a field of `{env.name}`: choose from {', '.join(own)}."
        )
    present = describe_env(env)
    differing = {
        name: _restored(recorded[name], value)
        for name, value in own.items()
        if name in recorded and name in present and recorded[name] != present[name]
    }
    # Of arrays only the digest is known: `_check_equal` refuses others.
    arrays = {name for name, value in own.items() if isinstance(value, np.ndarray | jax.Array)}
    changes = {name: value for name, value in differing.items() if name not in arrays} | overrides
    return dataclasses.replace(env, **changes) if changes else env


def _restored(value: Any, like: Any) -> Any:
    """Return a JSON value in the form of the field's present value."""
    if isinstance(value, list):
        parts = like if isinstance(like, tuple | list) and len(like) == len(value) else value
        return tuple(_restored(part, one) for part, one in zip(value, parts, strict=True))
    if isinstance(like, float) and isinstance(value, str):
        return float(value)  # "inf", "-inf" or "nan"
    return value


def _check_equal(env: AnyEnv, recorded: EnvRecord, ignored: tuple[str, ...]) -> None:
    found = describe_env(env)
    for name in found | recorded:
        if name in ignored or (name in found and found.get(name) == recorded.get(name, _MISSING)):
            continue
        now = repr(found[name]) if name in found else "gone"
        then = repr(recorded[name]) if name in recorded else "not there"
        raise ValueError(
            f"`{name}` of `{env.name}` is now {now}, but was {then} when the environment was "
            "recorded, so that it would give other numbers: restore it."
        )
