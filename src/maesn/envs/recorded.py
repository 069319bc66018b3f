"""Records of environments, so that a changed default in code cannot change an existing run.

`describe_env` records an environment as JSON values: its settings, the constants of its class, and
a digest of its MuJoCo model. It does not record the code of functions. `rebuild_env` makes the
environment again, and raises an error if it would differ from the record.
"""

import dataclasses
import hashlib
import inspect
import json
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
# Names, what the kind decides, what only figures and tables need, and choices, one of which is
# recorded. A digest stands for the model. `typing.Generic` sets the last.
_LEFT_OUT = (
    *("name", "engine", "has_one_reward", "defines_success", "planar"),
    *("variants", "model", "_is_protocol"),
)
_MODEL_DIGEST = "model_digest"
_CONSTANTS = (bool, int, float, str, tuple, np.ndarray, np.generic)
_MISSING = object()


def describe_env(env: AnyEnv) -> EnvRecord:
    """Return all settings and constants of an environment, as JSON values by name.

    These are the fields of the environment and the attributes of its class (`horizon`,
    `sparse_radius`, `control_period`, ...) that are numbers, strings, booleans, None, or tuples
    (named or not) or dataclasses of these. A digest stands for an array or a mapping, and
    `model_digest` for a MuJoCo model. Infinite numbers and NaN are written as text. Functions are
    left out.

    Raises:
        FileNotFoundError: its MuJoCo model is missing.
    """
    record: EnvRecord = {}
    for name in _attributes(type(env)):
        record |= _json_entries(name, getattr(env, name, None))
    if isinstance(env, AbstractMujocoEnv):
        record[_MODEL_DIGEST] = model_digest(env.model)
    return record


def rebuild_env(family: TaskFamily, recorded: EnvRecord, **overrides: Any) -> AnyEnv:
    """Return the environment of `describe_env`, whatever the family's defaults are today.

    Overrides are fields that are to differ from the record, such as `reward_kind`.

    Raises:
        ValueError: a constant of the environment or its model differs from the record, or a
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
    """Yield the name of every field and every constant of the class once."""
    names: dict[str, None] = {}
    for base in reversed(kind.__mro__):
        names |= dict.fromkeys(inspect.get_annotations(base))
        names |= {name: None for name, value in vars(base).items() if isinstance(value, _CONSTANTS)}
    for name in names:
        if not name.startswith("__") and name not in _LEFT_OUT:
            yield name


def _json_entries(name: str, value: Any) -> EnvRecord:
    """Return the entries that record a value: none if JSON cannot hold it."""
    if dataclasses.is_dataclass(value) or hasattr(value, "_fields"):  # or a named tuple
        entries: EnvRecord = {}
        for field in getattr(value, "_fields", None) or vars(value):
            part = _json_entries(f"{name}.{field}", getattr(value, field))
            if not part:  # a function: the dataclass does more than hold numbers
                return {}
            entries |= part
        return entries
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
    if isinstance(value, dict):
        text = json.dumps({name: _json(part) for name, part in value.items()}, sort_keys=True)
        return _digest(text.encode())
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        array = np.ascontiguousarray(value)
        content = f"{array.dtype.str}{array.shape}".encode() + array.tobytes()
        return _digest(content)
    raise TypeError


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def _from_family(family: TaskFamily, wanted: EnvRecord) -> AnyEnv:
    """Return the family's environment with the settings that `TaskFamily.make_env` takes."""
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
    present = describe_env(env)
    changes = {
        name: _from_json(recorded[name], like=value)
        for name, value in own.items()
        if name in recorded
        and name in present
        and recorded[name] != present[name]
        # A digest cannot be turned back into an array: `_check_equal` will refuse this one.
        and not isinstance(value, np.ndarray | jax.Array)
    } | overrides
    return dataclasses.replace(env, **changes) if changes else env


def _from_json(value: Any, like: Any) -> Any:
    """Return a JSON value with the type of the field's present value."""
    if isinstance(value, list):
        parts = like if isinstance(like, tuple | list) and len(like) == len(value) else value
        return tuple(_from_json(part, like=one) for part, one in zip(value, parts, strict=True))
    if isinstance(like, float) and isinstance(value, str):
        return float(value)  # "inf", "-inf" or "nan"
    return value


def _check_equal(env: AnyEnv, recorded: EnvRecord, ignored: tuple[str, ...]) -> None:
    found = describe_env(env)
    for name in found | recorded:
        if name in ignored or found.get(name, _MISSING) == recorded.get(name, _MISSING):
            continue
        now = repr(found[name]) if name in found else "gone"
        then = repr(recorded[name]) if name in recorded else "not there"
        raise ValueError(
            f"`{name}` of `{env.name}` is now {now}, but was {then} when the environment was "
            "recorded, so that it would give other numbers: restore it."
        )
