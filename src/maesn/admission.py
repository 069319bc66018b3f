"""Who may take part in a comparison, and what may be changed about whom."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from maesn.runs.beginning import check_sizes
from maesn.runs.contest import Ground
from maesn.runs.run import Run
from maesn.runs.starting import check_shown
from maesn.runs.storage import RunError
from maesn.runs.test_time import NOTHING_ADDED, AtTestTime


class Changes(NamedTuple):
    """What is changed about whom in the new tasks."""

    test_time: AtTestTime
    twice: Sequence[str]
    paces: Mapping[str, AtTestTime]

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


def check_world(runs: Sequence[Run], ground: Ground) -> None:
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


def check_methods(name: str, option: str, methods: Iterable[str], runs: Sequence[Run]) -> None:
    """Refuse names of methods of which there are no runs.

    Args:
        name: of the argument that names them.
        option: of the command line that does.
        methods: their names.
        runs: that are compared.

    Raises:
        RunError: of one there are none.
    """
    known = sorted({run.settings.method for run in runs})
    strangers = [method for method in methods if method not in known]
    if strangers:
        raise RunError(
            f"`{name}` ({option}) must be methods of the runs, "
            f"{', '.join(known) or 'of which there are none'}; got {', '.join(strangers)}."
        )
