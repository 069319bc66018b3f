"""Who may take part in a comparison, and what may be changed about whom."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from maesn.evaluation.test_time import NOTHING_ADDED, AtTestTime
from maesn.runs.beginning import check_sizes
from maesn.runs.run import Run
from maesn.runs.starting import check_shown
from maesn.storage import RunError
from maesn.studies.curves import ComparisonWorld

AS_TRAINED: Mapping[str, AtTestTime] = MappingProxyType({})


class Changes(NamedTuple):
    """What is changed about whom in the new tasks. By default nothing."""

    test_time: AtTestTime = NOTHING_ADDED
    """If it changes anything, runs take part a second time, changed like this."""
    twice: Sequence[str] = ()
    """Runs of which methods do; empty for all that can be changed."""
    paces: Mapping[str, AtTestTime] = AS_TRAINED
    """Step sizes of all runs of a method, by its name, also where they take part a second time.
    Methods that are not named keep their own."""

    def of(self, method: str) -> tuple[AtTestTime, AtTestTime | None]:
        """Return how a method takes part, and how a second time; None if it does not."""
        pace = self.paces.get(method, NOTHING_ADDED)
        if not self.test_time.suffix or (self.twice and method not in self.twice):
            return pace, None
        tuned = self.test_time
        if pace.suffix:
            tuned = dataclasses.replace(
                tuned, step_scale=pace.step_scale, full_steps=pace.full_steps
            )
        return pace, tuned


def open_oracle(directory: str | Path, family: str | None) -> Run:
    """Open a run whose policy is told the task.

    Args:
        directory: of the run.
        family: the run's family, if it is the user's own.

    Raises:
        RunError: it cannot be read, or is a run of another method.
    """
    run = Run.open(directory, family=family)
    if run.settings.method != "oracle":
        raise RunError(
            f"`{run.directory}` must be a run of `oracle`, which is told the task, to be the "
            f"ceiling of a score, but is one of `{run.settings.method}`: train one with `maesn "
            "train oracle`."
        )
    return run


def check_world(runs: Sequence[Run], ground: ComparisonWorld) -> None:
    """Refuse runs that were trained in another family, or cannot play in this world.

    Raises:
        RunError: a run was, or cannot.
    """
    for run in runs:
        if run.config.family != ground.env.name:
            raise RunError(
                f"`{run.directory}` must be a run on {ground.env.name} to be compared there, got "
                f"one on {run.config.family}: leave it out, or give another --family."
            )
        check_sizes(run, ground.env, "compare it in the variant that it was trained in")
        check_shown(run.learner.player(run.latest_state()), ground.env)


def check_changes(changes: Changes, runs: Sequence[Run], updates: int) -> None:
    """Refuse changes that would never show, or that are not what they are given as.

    Args:
        changes: of how the runs take part.
        runs: that are compared.
        updates: number of updates in the new tasks.

    Raises:
        RunError: of a method that is named there are no runs; nothing is changed about runs that
            shall take part twice; a pace says more than step sizes; or what is changed would begin
            after the last update.
    """
    _check_methods("twice", "--twice", changes.twice, runs)
    _check_methods("paces", "--step-scales, --full-steps", changes.paces, runs)
    if changes.test_time.suffix and not runs:
        raise RunError(
            "`test_time` (--fine-tune, --curious) changes trained runs, of which none take part: "
            "name their directories, or leave it out."
        )
    for method, pace in changes.paces.items():
        if pace.fine_tune or pace.curious:
            raise RunError(
                f"`paces` must hold step sizes alone, but says more of {method}: {pace.label}. "
                "Give that as `test_time`."
            )
    if changes.twice and not changes.test_time.suffix:
        raise RunError(
            "`twice` (--twice) says which runs take part a second time, but nothing is changed "
            "about them: say what with --fine-tune or --curious."
        )
    changes.test_time.check_reached(updates)


def _check_methods(name: str, option: str, methods: Iterable[str], runs: Sequence[Run]) -> None:
    known = sorted({run.settings.method for run in runs})
    strangers = [method for method in methods if method not in known]
    if strangers:
        raise RunError(
            f"`{name}` ({option}) must be methods of the runs, "
            f"{', '.join(known) or 'of which there are none'}; got {', '.join(strangers)}."
        )
