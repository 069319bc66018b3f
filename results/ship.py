"""Make the policies that the package ships out of finished runs.

    python results/ship.py runs/wheeled --commit 87cd55a
    python results/ship.py --study field --out results --commit 87cd55a

writes `src/maesn/trained/NAME`: the run's last checkpoint without a replay, its `config.json` with
where the policy comes from as an entry `provenance`, and its prior for the rule `search`. NAME is
the family, and behind it the variant if it is not the usual one: `maesn adapt sparse_point-varibad`
then adapts it on every installation. Of a study it ships one run for each family, of the first
seed: no seed is chosen by what it reaches.
"""

import dataclasses
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import tyro

from maesn.learners import PRESETS, AbstractMetaLearner, recommended, recommended_run
from maesn.runs.checkpoint import REPLAY
from maesn.runs.config import RunConfig, RunSettings, write_config
from maesn.runs.run import Run
from maesn.runs.sources import TASKS_FILE, TRAINED
from maesn.search.stored import run_prior
from maesn.serialization import TAG, fields_to_json, to_json
from maesn.settings import leaves
from maesn.studies.members import RUN
from maesn.studies.study import JOBS, Study


@dataclasses.dataclass(frozen=True)
class Settings:
    """What is shipped."""

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Directories of finished runs."""
    commit: str
    """Of the code that trained them."""
    study: str = ""
    """A study that has trained runs as well: its name, or the path of its file."""
    line: str = "maesn"
    """Name of these runs in the study."""
    out: Path = Path("results")
    """Directory of the study."""


def command(config: RunConfig) -> str:
    """Return the command that trains such a run, with the settings that are not the usual ones.

    Raises:
        ValueError: no command trains such a learner.
    """
    method, family = config.settings.method, config.settings.family
    kind = config.world["action_kind"]  # which a run chooses its policy for
    if method not in PRESETS:
        raise ValueError(f"`method` must be one of {', '.join(PRESETS)}, got {method!r}.")
    chosen = _changes(config, RunSettings(), PRESETS[method]().for_actions(kind))
    words = ["maesn train", method, "--settings reference"]
    if _slots(chosen):
        suited = RunSettings(**recommended_run(method, family))
        learner = recommended(method, family).for_actions(kind)
        chosen, words = _changes(config, suited, learner), words[:2]
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
    saved = shipped.save_state(checkpoint.state, checkpoint.environment_steps)
    for replay in saved.parent.glob(f"{REPLAY}*"):  # only more training would need it
        replay.unlink()
    if (run.directory / TASKS_FILE).exists():
        shutil.copy(run.directory / TASKS_FILE, target)
    write_config(target, shipped.config)


def runs_of_study(study: str, line: str, out: Path) -> list[Path]:
    """Return the directory of the first seed of a study's run, for each family."""
    found = (
        one.first.needs[0]
        for comparison in Study.load(study).comparisons
        for one in comparison.lines["lines"]
        if one.source == line
    )
    return [out / JOBS / job / RUN for job in dict.fromkeys(found)]


def name_of(run: Run) -> str:
    """Return the name of a policy: that of its family, and of its variant if it is unusual."""
    variant = run.env().variant
    usual = run.family.make_env().variant
    return run.family.name if variant == usual else f"{run.family.name}-{variant}"


def main(settings: Settings) -> None:
    """Ship runs under their names."""
    of_study = (settings.study, settings.line, settings.out)
    for path in (*settings.runs, *(runs_of_study(*of_study) if settings.study else ())):
        run = Run.open(path)
        target = TRAINED / name_of(run)
        ship(run, settings.commit, target)
        print(target, run_prior(Run.open(target), directory=target)[0])


if __name__ == "__main__":
    main(tyro.cli(Settings))
