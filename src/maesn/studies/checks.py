"""Which runs can be compared, and what is changed about them in the new tasks."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from maesn.evaluation.rules import AbstractRule, AbstractWrapper
from maesn.runs.run import Run
from maesn.runs.starting import check_policy, check_sizes
from maesn.storage import RunError
from maesn.studies.curves import ComparisonWorld

OWN_RULES: Mapping[str, AbstractRule] = MappingProxyType({})


class Changes(NamedTuple):
    """What is changed about whom in the new tasks. By default nothing."""

    wrappers: tuple[AbstractWrapper, ...] = ()
    """If there are any, runs take part a second time, with these."""
    twice: Sequence[str] = ()
    """Runs of which methods do; empty for all that can be given them."""
    rules: Mapping[str, AbstractRule] = OWN_RULES
    """Rules of all runs of a method, by its name, also where they take part a second time. Methods
    that are not named follow their own."""

    def second_time(self, method: str) -> bool:
        """Whether runs of a method take part a second time."""
        return bool(self.wrappers) and (not self.twice or method in self.twice)


def open_oracle(directory: str | Path, family: str | None) -> Run:
    """Open a run whose policy is given the task.

    Args:
        directory: of the run.
        family: the run's family, if it is the user's own.

    Raises:
        RunError: it cannot be read, or is a run of another method.
    """
    run = Run.open(directory, family=family)
    if run.settings.method != "oracle":
        raise RunError(
            f"`{run.directory}` must be a run of `oracle`, which is given the task, to be the "
            f"ceiling of a score, but is one of `{run.settings.method}`: train one with `maesn "
            "train oracle`."
        )
    return run


def check_world(runs: Sequence[Run], world: ComparisonWorld) -> None:
    """Refuse runs that were trained in another family, or cannot play in this world.

    Raises:
        RunError: a run was, or cannot.
    """
    for run in runs:
        if run.config.family != world.env.name:
            raise RunError(
                f"`{run.directory}` must be a run on {world.env.name} to be compared there, got "
                f"one on {run.config.family}: leave it out, or give another --family."
            )
        check_sizes(
            run.directory, run.env(), world.env, "compare it in the variant that it was trained in"
        )
        check_policy(run.learner, run.latest_state(), world.env)


def check_changes(changes: Changes, runs: Sequence[Run]) -> None:
    """Refuse changes that would never show.

    Args:
        changes: of how the runs take part.
        runs: that are compared.

    Raises:
        RunError: of a method that is named there are no runs, or nothing is changed about runs that
            shall take part twice.
    """
    _check_methods("twice", changes.twice, runs)
    _check_methods("rules", changes.rules, runs)
    if changes.wrappers and not runs:
        raise RunError(
            "`then` and `bonus` add to trained runs, of which none take part: name their "
            "directories, or leave it out."
        )
    if changes.twice and not changes.wrappers:
        raise RunError(
            "`twice` says which runs take part a second time, but nothing is added to them: say "
            "what with `then` or `bonus`."
        )


def _check_methods(name: str, methods: Iterable[str], runs: Sequence[Run]) -> None:
    known = sorted({run.settings.method for run in runs})
    unknown = [method for method in methods if method not in known]
    if unknown:
        raise RunError(
            f"`{name}` must be methods of the runs, "
            f"{', '.join(known) or 'of which there are none'}; got {', '.join(unknown)}."
        )
