"""What is attacked: small runs, and one file of each kind that the library writes."""

import json
import shutil
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from small_runs import Drift, create, create_tiny, finish, goals, outcome

from maesn import api
from maesn.evaluation import running
from maesn.evaluation.running import Adapted
from maesn.reporting.reading import RECORD
from maesn.rules import SearchRule
from maesn.runs.run import Run
from maesn.runtime import Explorer, Safeguards
from maesn.runtime.return_model import ReturnPrior
from maesn.search import stored
from maesn.search.prior import PriorSettings

ITERATIONS = 6
MORE = 8
"""Iterations after a run was gone on with."""
ADAPTATION: dict[str, Any] = {"num_tasks": 2, "episodes": 4, "episodes_per_update": 2}
PRIOR = PriorSettings(draws=12, adapted=False, episodes=2, searches=0)
SAFEGUARDS = Safeguards(lower=(-0.05, -0.04), max_change=0.03, max_latent_norm=0.7)

Outcome = tuple[bytes, dict[str, bytes]]
"""The log of a run, and the tensors of its last checkpoint."""


@dataclass
class Material:
    """Made once; each fault gets a copy."""

    directory: Path
    operations: dict[str, int] = field(default_factory=dict)
    """How many operations on files there are in each scenario."""
    read: dict[str, Any] = field(default_factory=dict)
    """What is read of sound files."""

    def __post_init__(self) -> None:
        # All of it: a process that was forked can compute little.
        for name, value in vars(type(self)).items():
            if isinstance(value, cached_property):
                getattr(self, name)

    @cached_property
    def untrained(self) -> Any:
        """The state of a new run, which a process that was forked cannot compute."""
        return self.run.load(self.run.checkpoints()[0]).state

    @cached_property
    def run(self) -> Run:
        """A finished run of six iterations on tasks of its own."""
        return finish(self.new(self.directory / "run"))

    def new(self, directory: Path) -> Run:
        """A run that has not begun."""
        tasks = self.directory / "goals.npz"
        if not tasks.exists():
            np.savez(tasks, goal=goals(3))
        return create(directory, Drift(), iterations=ITERATIONS, tasks=str(tasks))

    def copy(self, directory: Path) -> Run:
        """The same run."""
        return Run.open(shutil.copytree(self.run.directory, directory))

    @cached_property
    def outcome(self) -> Outcome:
        """What six iterations become."""
        return outcome(self.run)

    @cached_property
    def longer(self) -> Outcome:
        """What eight become."""
        run = self.copy(self.directory / "longer")
        return outcome(finish(run, MORE))

    @cached_property
    def latent(self) -> Run:
        """A run of the real method, with the files of an adaptation and of a search."""
        run = create_tiny(self.directory / "latent")
        stored.run_prior(run, PRIOR)
        return run

    @cached_property
    def prior(self) -> ReturnPrior:
        """What the training tasks return there."""
        (file,) = (self.latent.directory / "priors").iterdir()
        return stored.read_prior(file)[0]

    @cached_property
    def adapted(self) -> Adapted:
        """What an adaptation of it has found."""
        return api.adapt(self.latent, **ADAPTATION)

    @cached_property
    def record(self) -> dict[str, Any]:
        """How that was made."""
        found: dict[str, Any] = json.loads(self.adapted.table.with_suffix(RECORD).read_text())
        return found

    def adapt_again(self, run: Run) -> Adapted:
        """Adapt without playing: a process that was forked cannot."""
        before, running.evaluate = running.evaluate, lambda *_: (self.adapted.outcome, self.record)
        try:
            return api.adapt(run, **ADAPTATION)
        finally:
            running.evaluate = before

    @cached_property
    def policies(self) -> tuple[Path, Path]:
        """An exported policy that follows the gradient, and one that searches."""
        follows, searches = self.directory / "follows.npz", self.directory / "searches.npz"
        api.export(self.latent, follows)
        api.export(self.latent, searches, rule=SearchRule())
        return follows, searches

    @cached_property
    def explorers(self) -> tuple[Path, Path]:
        """Both, saved in the middle of an episode."""
        return self._saved(self.policies[0]), self._saved(self.policies[1])

    @cached_property
    def folders(self) -> dict[str, Path]:
        """Directories with one file of each kind."""
        policies = self.directory / "policies"
        policies.mkdir()
        for path in (*self.policies, *self.explorers):
            shutil.copy(path, policies)
        self.adapted  # noqa: B018  # leaves files
        return {"run": self.run.directory, "latent": self.latent.directory, "policies": policies}

    def _saved(self, policy: Path) -> Path:
        explorer = Explorer.load(policy, seed=3, safeguards=SAFEGUARDS)
        for number in range(5):
            explorer.begin_episode()
            for observation in ([0.0, 0.1], [0.2, -0.1]):
                explorer.act(observation)
            explorer.end_episode([0.5, 0.1 * number])
            if number == 2:
                explorer.adapt()
        explorer.begin_episode()
        explorer.act([0.3, 0.3])
        path = policy.with_stem(f"{policy.stem}-saved")
        explorer.save(path)
        return path
