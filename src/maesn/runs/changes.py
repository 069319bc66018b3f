"""Deliberate changes of a run that has begun, written down in its `config.json`."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx

from maesn.envs import describe_env
from maesn.runs.config import Change, RunSettings, write_config
from maesn.runs.run import Run
from maesn.runs.serialization import replaced
from maesn.storage import RunError, refusals
from maesn.worlds import engine_of

# Without these what was learned is of no use.
_FIXED = ("method", "family", "variant", "tasks")
CHANGEABLE = tuple(name for name in RunSettings.__dataclass_fields__ if name not in _FIXED)


def change_run(run: Run, changes: Mapping[str, Any]) -> Run:
    """Change settings of a run from its latest checkpoint on, write that down, and return the run.

    Names are those in `CHANGEABLE`, and those of the learner's settings, such as
    `trust_region.damping`. Where a name or a value cannot be used nothing is written.
    """
    own = {name: value for name, value in changes.items() if name in CHANGEABLE}
    with refusals("the change cannot be made: "):
        settings = replaced(run.settings, own)
        try:
            learner = replaced(run.learner, {n: v for n, v in changes.items() if n not in own})
        except KeyError as error:
            raise _refusal(error.args[0]) from error
        learner.check_batch(settings.episodes_per_task)
        if settings.sparse_radius is None and "sparse_radius" in changes:
            raise ValueError("`sparse_radius` must be a number of metres, got None.")
        env = run.env(settings.reward, settings.sparse_radius)
        engine = engine_of(env, settings.engine)
    with run.alone():
        change = Change(run.latest().iteration, dict(changes), run.config.digest())
        config = dataclasses.replace(
            run.config,
            settings=settings,
            learner=learner,
            world=describe_env(env),
            engine=engine,
            changes=(*run.config.changes, change),
        )
        changed = dataclasses.replace(run, config=config)
        if not eqx.tree_equal(changed.structure(), run.structure()):
            raise _refusal(", ".join(changes))
        changed.world().close()  # the engine may lack something
        write_config(run.directory, config)
    return changed


def _refusal(name: str) -> RunError:
    return RunError(
        f"`{name}` cannot change in a run that has begun. What can: {', '.join(CHANGEABLE)}, and "
        "those settings of the learner that leave its arrays as they are, such as "
        "`trust_region.damping`. For anything else start a new run (`maesn train --init-from`)."
    )
