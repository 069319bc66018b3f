"""Work on files that may fail at any moment, and how to see that nothing was lost by it."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from faults.material import MORE, PRIOR, Material
from faults.processes import count_operations
from small_runs import finish, outcome

from maesn import api
from maesn.runs.config import CONFIG
from maesn.runs.run import Run
from maesn.runtime import Explorer
from maesn.search import stored
from maesn.search.stored import read_prior


@dataclass(frozen=True)
class Scenario:
    """One thing that the library does with files in a directory."""

    prepare: Callable[[Material, Path], None]
    work: Callable[[Material, Path], Any]
    """Runs in a process of its own."""
    lost: Callable[[Material, Path], str]
    """Go on where the work has ended in whatever way; say what is lost, if anything is."""


def _begin(material: Material, directory: Path) -> None:
    material.new(directory / "run")


def _copy(material: Material, directory: Path) -> None:
    material.copy(directory / "run")


def _differs(run: Run, iterations: int, wanted: Any) -> str:
    before = run.latest().iteration
    found = outcome(finish(run, iterations))
    return "" if found == wanted else f"the run ends with other bytes (it went on from {before})"


def _create(material: Material, directory: Path) -> None:
    original, Run.untrained_state = Run.untrained_state, lambda _: material.untrained  # type: ignore[method-assign]
    try:
        material.new(directory / "run")
    finally:
        Run.untrained_state = original  # type: ignore[method-assign]


def _after_create(material: Material, directory: Path) -> str:
    if not (directory / "run" / CONFIG).exists():
        _create(material, directory)
    return _differs(Run.open(directory / "run"), 6, material.outcome)


def _train(_: Material, directory: Path) -> None:
    finish(Run.open(directory / "run"))


def _after_train(material: Material, directory: Path) -> str:
    return _differs(Run.open(directory / "run"), 6, material.outcome)


def _resume(_: Material, directory: Path) -> None:
    finish(Run.open(directory / "run"), MORE)


def _after_resume(material: Material, directory: Path) -> str:
    run = Run.open(directory / "run")
    if run.latest().iteration < 6:
        return "checkpoints of the session before"
    return _differs(run, MORE, material.longer)


def _copy_latent(material: Material, directory: Path) -> None:
    shutil.copytree(material.latent.directory, directory / "run")


def _adapt(material: Material, directory: Path) -> None:
    material.adapt_again(Run.open(directory / "run"))


def _after_adapt(material: Material, directory: Path) -> str:
    def content(folder: Path) -> dict[str, bytes]:
        files = (folder / "adaptation").glob("*.*")
        return {file.name: file.read_bytes() for file in files if file.suffix != ".partial"}

    wanted, found = content(material.latent.directory), content(directory / "run")
    lost = [name for name, value in wanted.items() if found.get(name, value) != value]
    lost += [name for name in wanted.keys() - found.keys() if not name.endswith(".json")]
    _adapt(material, directory)
    lost += [name for name, value in content(directory / "run").items() if wanted[name] != value]
    return ", ".join(lost)


def _prior(material: Material, directory: Path) -> None:
    original, stored.make_prior = stored.make_prior, lambda *_, **__: material.prior  # type: ignore[assignment]
    try:
        stored.run_prior(Run.open(directory / "run"), PRIOR)
    finally:
        stored.make_prior = original


def _after_prior(material: Material, directory: Path) -> str:
    (file,) = (directory / "run" / "priors").glob("*.safetensors")
    found = read_prior(file)[0]
    same = all(np.array_equal(getattr(found, n), x) for n, x in vars(material.prior).items())
    return "" if same else "the prior"


def _prepare_export(material: Material, directory: Path) -> None:
    shutil.copy(material.policies[1], directory / "policy.npz")


def _export(material: Material, directory: Path) -> None:
    api.export(material.latent, directory / "policy.npz", overwrite=True)


def _prepare_save(material: Material, directory: Path) -> None:
    shutil.copy(material.explorers[0], directory / "policy.npz")


def _save(_: Material, directory: Path) -> None:
    explorer = Explorer.load(directory / "policy.npz")
    explorer.act([0.1, 0.2])
    explorer.save(directory / "policy.npz")


def _after_save(_: Material, directory: Path) -> str:
    explorer = Explorer.load(directory / "policy.npz")
    return "" if len(explorer.episodes) == 2 and explorer.update == 1 else "episodes"


def _after_export(_: Material, directory: Path) -> str:
    return "" if Explorer.load(directory / "policy.npz").update == 0 else "the policy"


SCENARIOS = {
    "create": Scenario(lambda *_: None, _create, _after_create),
    "train": Scenario(_begin, _train, _after_train),
    "resume": Scenario(_copy, _resume, _after_resume),
    "adapt": Scenario(_copy_latent, _adapt, _after_adapt),
    "prior": Scenario(_copy_latent, _prior, _after_prior),
    "export": Scenario(_prepare_export, _export, _after_export),
    "save": Scenario(_prepare_save, _save, _after_save),
}


def operations(name: str, material: Material) -> int:
    """How many operations on files there are in a scenario."""
    if name not in material.operations:
        trial = material.directory / f"trial-{name}"
        trial.mkdir(exist_ok=True)
        SCENARIOS[name].prepare(material, trial)
        work = partial(SCENARIOS[name].work, material, trial)
        material.operations[name] = count_operations(work, trial)
    return material.operations[name]
