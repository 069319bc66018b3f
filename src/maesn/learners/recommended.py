"""Settings that were found to work on a family: `recommended.toml` has them and the evidence."""

import dataclasses
import tomllib
from importlib.resources import files
from typing import Any, TypeVar

from maesn import policies
from maesn.learners.meta import AbstractMetaLearner
from maesn.learners.presets import PRESETS
from maesn.settings import leaves

Settings = TypeVar("Settings")

RECOMMENDED: dict[str, dict[str, dict[str, Any]]] = tomllib.loads(
    (files("maesn.learners") / "recommended.toml").read_text(encoding="utf-8")
)
"""Family -> method -> settings of the learner, nested; those of the run are under `run`."""
ANY = "any"
"""Stands for every family in `RECOMMENDED`; a family's own settings override its."""


def recommended(method: str, family: str) -> AbstractMetaLearner[Any, Any]:
    """Return a method with the settings that suit a family; its preset where none are known.

    Args:
        method: as in `maesn.PRESETS`.
        family: name of a family.

    Raises:
        ValueError: there is no such method.
    """
    if method not in PRESETS:
        raise ValueError(f"`method` must be one of {', '.join(PRESETS)}, got {method!r}.")
    learner = PRESETS[method]()
    for path, value in recommended_settings(method, family).items():
        learner = with_setting(learner, path, value)
    return learner


def recommended_settings(method: str, family: str) -> dict[str, Any]:
    """Return the settings of the learner that suit a family, by path; none where none are known."""
    found: dict[str, Any] = {}
    for name in (ANY, family):
        table = dict(RECOMMENDED.get(name, {}).get(method, {}))
        table.pop("run", None)
        policy = table.pop("policy", None)
        # TOML has no tuples, of which settings are made.
        found |= {path: tuple(x) if isinstance(x, list) else x for path, x in leaves(table).items()}
        if policy is not None:
            found["policy"] = _policy(policy)
    return found


def recommended_run(method: str, family: str) -> dict[str, Any]:
    """Return the settings of a run that suit a method on a family, by name."""
    found: dict[str, Any] = {}
    for name in (ANY, family):
        found |= RECOMMENDED.get(name, {}).get(method, {}).get("run", {})
    return found


def with_setting(settings: Settings, path: str, value: Any) -> Settings:
    """Return settings with another value at a path such as `outer.trust_region.damping`."""
    name, _, rest = path.partition(".")
    if rest:
        value = with_setting(getattr(settings, name), rest, value)
    return dataclasses.replace(settings, **{name: value})  # type: ignore[type-var]


def _policy(named: str | dict[str, Any]) -> Any:
    settings = {"type": named} if isinstance(named, str) else dict(named)
    return getattr(policies, settings.pop("type"))(**settings)
