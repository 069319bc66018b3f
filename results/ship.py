"""Make the policy that the package ships for a family out of a finished run.

    python results/ship.py runs/wheeled --commit 87cd55a

writes `src/maesn/trained/FAMILY`: the run's last checkpoint, its `config.json` with where the
policy comes from as an entry `provenance`, and its prior for the rule `search`. `maesn adapt
FAMILY` then adapts it on every installation.
"""

import dataclasses
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import tyro

from maesn.learners import METHODS
from maesn.runs.config import RunConfig, RunSettings, write_config
from maesn.runs.run import Run
from maesn.runs.serialization import TAG, fields_to_json, to_json
from maesn.runs.sources import TASKS_FILE, TRAINED
from maesn.search.stored import run_prior


@dataclasses.dataclass(frozen=True)
class Settings:
    """What is shipped."""

    run: tyro.conf.Positional[Path]
    """Directory of a finished run."""
    commit: str
    """Of the code that trained it."""


def command(config: RunConfig) -> str:
    """Return the command that trains such a run: the settings that are not the method's own.

    Raises:
        ValueError: no command trains such a learner.
    """
    method = config.settings.method
    if method not in METHODS:
        raise ValueError(f"`method` must be one of {', '.join(METHODS)}, got {method!r}.")
    found = _options(fields_to_json(config.settings)) | _options(to_json(config.learner))
    usual = _options(fields_to_json(RunSettings())) | _options(to_json(METHODS[method]()))
    chosen = {name: value for name, value in found.items() if usual.get(name) != value}
    slots = [name for name in chosen if name.split(".")[-1] == TAG]
    if slots:
        raise ValueError(f"no option of `maesn train {method}` changes {', '.join(slots)}.")
    del chosen["method"]
    words = [f"--{name.replace('_', '-')} {value}" for name, value in chosen.items()]
    return " ".join(["maesn train", method, "--settings reference", *words])


def _options(document: dict[str, Any]) -> dict[str, str]:
    return dict(_leaves("", document))


def _leaves(prefix: str, document: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the name and the value of every option, as the command line has them."""
    for name, value in document.items():
        if isinstance(value, dict):
            yield from _leaves(f"{prefix}{name}.", value)
        else:
            values = value if isinstance(value, list) else [value]
            yield prefix + name, " ".join(map(str, values))


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
    shipped = dataclasses.replace(
        run, directory=target, config=dataclasses.replace(run.config, provenance=provenance)
    )
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
    print(target, run_prior(Run.open(target))[0])


if __name__ == "__main__":
    main(tyro.cli(Settings))
