"""Deliberate changes of a run that has begun, written down in its `config.json`."""

import ast
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx

from maesn.envs import describe_env
from maesn.learners import AbstractMetaLearner
from maesn.runs.config import Change, RunConfig, RunSettings, write_config
from maesn.runs.run import Run
from maesn.runs.serialization import TAG, fields_from_json, fields_to_json, from_json, to_json
from maesn.storage import RunError, refusals
from maesn.worlds import engine_of

FIXED = ("method", "family", "variant", "tasks")
"""Settings of a run that cannot change: without them what was learned is of no use."""
CHANGEABLE = tuple(name for name in RunSettings.__dataclass_fields__ if name not in FIXED)


def change_run(run: Run, changes: Mapping[str, Any]) -> Run:
    """Change settings of a run from its latest checkpoint on, write that down, and return the run.

    Args:
        run: that has begun.
        changes: name -> value. Names are those in `CHANGEABLE`, and those of the learner's
            settings as on the command line of `maesn train`, such as `trust_region.damping`.

    Raises:
        RunError: a name or a value cannot be used; nothing was written.
    """
    with refusals("the change cannot be made: "):
        config = _changed(run, changes)
    change = Change(run.latest().iteration, dict(changes), run.config.digest())
    config = dataclasses.replace(config, changes=(*config.changes, change))
    changed = dataclasses.replace(run, config=config)
    if not eqx.tree_equal(changed.structure(), run.structure()):
        raise RunError(_refusal(", ".join(changes)))
    changed.world().close()  # the engine may lack something
    write_config(run.directory, config)
    return changed


def parse_changes(words: Sequence[str]) -> dict[str, Any]:
    """Return the changes that `NAME=VALUE` words ask for.

    Raises:
        RunError: a word has another form, or a name occurs twice.
    """
    changes: dict[str, Any] = {}
    for word in words:
        name, equals, text = word.partition("=")
        name = name.replace("-", "_")
        if not (name and equals) or name in changes:
            raise RunError(f"`--change` expects NAME=VALUE, each name once, got `{word}`.")
        try:
            changes[name] = ast.literal_eval(text)  # literals alone: numbers, True, None, tuples
        except (ValueError, SyntaxError):
            changes[name] = text
    return changes


def _changed(run: Run, changes: Mapping[str, Any]) -> RunConfig:
    """Return the configuration with other values; raises ValueError where they are refused."""
    settings, learner = fields_to_json(run.settings), to_json(run.learner)
    for name, value in changes.items():
        if name in settings and name not in CHANGEABLE:
            raise RunError(_refusal(name))
        _set(settings if name in CHANGEABLE else learner, name, value)
    new_settings = fields_from_json(RunSettings, settings)
    new_learner = from_json(learner)
    assert isinstance(new_learner, AbstractMetaLearner)
    new_learner.check_batch(new_settings.episodes_per_task)
    if new_settings.sparse_radius is None and "sparse_radius" in changes:
        raise ValueError("`sparse_radius` must be a number of metres, got None.")
    env = run.env(new_settings.reward, new_settings.sparse_radius)
    return dataclasses.replace(
        run.config,
        settings=new_settings,
        learner=new_learner,
        world=describe_env(env),
        engine=engine_of(env, new_settings.engine),
    )


def _set(document: dict[str, Any], path: str, value: Any) -> None:
    """Replace what stands at a path such as `trust_region.damping`."""
    *parents, last = path.split(".")
    for parent in parents:
        document = document.get(parent) or {}
    if last not in document or last == TAG or isinstance(document[last], dict):
        raise RunError(_refusal(path))
    document[last] = value


def _refusal(name: str) -> str:
    return (
        f"`{name}` cannot change in a run that has begun. What can: {', '.join(CHANGEABLE)}, and "
        "those settings of the learner that leave its arrays as they are, such as "
        "`trust_region.damping`. For anything else start a new run (`maesn train --init-from`)."
    )
