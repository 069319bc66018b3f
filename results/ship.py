"""Make the policy that the package ships for a family out of a finished run.

    python results/ship.py runs/wheeled --commit 87cd55a

writes `src/maesn/trained/FAMILY`: the run's last checkpoint, its `config.json` with where the
policy comes from as an entry `provenance`, and its prior for the rule `search`. `maesn adapt
FAMILY` then adapts it on every installation.
"""

import dataclasses
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import tyro

from maesn.learners import PRESETS, AbstractMetaLearner, recommended, recommended_run
from maesn.runs.config import RunConfig, RunSettings, write_config
from maesn.runs.run import Run
from maesn.runs.serialization import TAG, fields_to_json, to_json
from maesn.runs.sources import TASKS_FILE, TRAINED
from maesn.search.stored import run_prior
from maesn.settings import leaves


@dataclasses.dataclass(frozen=True)
class Settings:
    """What is shipped."""

    run: tyro.conf.Positional[Path]
    """Directory of a finished run."""
    commit: str
    """Of the code that trained it."""


def command(config: RunConfig) -> str:
    """Return the command that trains such a run, with the settings that are not the usual ones.

    Raises:
        ValueError: no command trains such a learner.
    """
    method, family = config.settings.method, config.settings.family
    if method not in PRESETS:
        raise ValueError(f"`method` must be one of {', '.join(PRESETS)}, got {method!r}.")
    chosen = _changes(config, RunSettings(), PRESETS[method]())
    words = ["maesn train", method, "--settings reference"]
    if _slots(chosen):
        suited = RunSettings(**recommended_run(method, family)), recommended(method, family)
        chosen, words = _changes(config, *suited), words[:2]
    if slots := _slots(chosen):
        raise ValueError(f"no option of `maesn train {method}` changes {', '.join(slots)}.")
    return " ".join([*words, *(f"--{name.replace('_', '-')} {x}" for name, x in chosen.items())])


def _changes(
    config: RunConfig, settings: RunSettings, learner: AbstractMetaLearner[Any, Any]
) -> dict[str, str]:
    """Return by name the options that differ from these settings, as the command line has them."""
    found = leaves(fields_to_json(config.settings) | to_json(config.learner))
    usual = leaves(fields_to_json(settings) | to_json(learner))
    return {
        name: " ".join(map(str, value if isinstance(value, list) else [value]))
        for name, value in found.items()
        if usual.get(name) != value and name != "method"
    }


def _slots(options: Iterable[str]) -> list[str]:
    return [name for name in options if name.split(".")[-1] == TAG]


def ship(run: Run, commit: str, target: Path) -> None:
    """Write the directory that is shipped.

    Args:
        run: a finished one.
        commit: of the code that trained it.
        target: the directory; what it holds is replaced.

    Raises:
        ValueError: the run is not finished, or its last checkpoint is damaged.
    """
    last, done = run.checkpoints()[-1], run.latest().iteration
    if done != run.settings.iterations or run.load(last).iteration != done:
        raise ValueError(
            f"`{run.directory}` must be finished, but has done {done} of "
            f"{run.settings.iterations} iterations: go on with `maesn resume {run.directory}`."
        )
    provenance = run.config.provenance | {"command": command(run.config), "commit": commit}
    # Who adapts it has other processors.
    usual = dataclasses.replace(run.settings, num_threads=RunSettings().num_threads)
    config = dataclasses.replace(run.config, settings=usual, provenance=provenance)
    shipped = dataclasses.replace(run, directory=target, config=config)
    checkpoint = run.latest()
    if target.exists():
        shutil.rmtree(target)
    # Written anew, because a checkpoint states the digest of the configuration beside it.
    shipped.save_state(checkpoint.state, checkpoint.environment_steps)
    if (run.directory / TASKS_FILE).exists():
        shutil.copy(run.directory / TASKS_FILE, target)
    write_config(target, shipped.config)


def main(settings: Settings) -> None:
    """Ship a run under the name of its family."""
    run = Run.open(settings.run)
    target = TRAINED / run.family.name
    ship(run, settings.commit, target)
    print(target, run_prior(Run.open(target), directory=target)[0])


if __name__ == "__main__":
    main(tyro.cli(Settings))
