"""Settings that were found to work on a family: `recommended.toml` has them and the evidence."""

import tomllib
from importlib.resources import files
from typing import Any

from maesn.learners.meta import AbstractMetaLearner
from maesn.learners.presets import PRESETS
from maesn.serialization import replaced
from maesn.settings import leaves

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
    return replaced(PRESETS[method](), recommended_settings(method, family))


def recommended_settings(method: str, family: str) -> dict[str, Any]:
    """Return the settings of the learner that suit a family, by path; none where none are known."""
    found: dict[str, Any] = {}
    for name in (ANY, family):
        table = dict(RECOMMENDED.get(name, {}).get(method, {}))
        table.pop("run", None)
        found |= leaves(table)
    return found


def recommended_run(method: str, family: str) -> dict[str, Any]:
    """Return the settings of a run that suit a method on a family, by name."""
    found: dict[str, Any] = {}
    for name in (ANY, family):
        found |= RECOMMENDED.get(name, {}).get(method, {}).get("run", {})
    return found
