"""`maesn render DIR --task 3 --after 0 250`: film a trained policy in a new task."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from maesn.commands.evaluation import EvaluationOptions
from maesn.commands.options import parse
from maesn.evaluation import film
from maesn.runs.compilation import enable_compilation_cache


@dataclasses.dataclass(frozen=True)
class Options:
    """Film how a trained policy explores a new task, and what it does after adapting to it."""

    run: tyro.conf.Positional[Path]
    """Directory of the run, whose last checkpoint is adapted, or the name of a policy that comes
    with the library (`maesn list`). A directory of that name in the current folder wins; without
    one, files go to `maesn-NAME` there, a run directory like any other."""
    evaluation: Annotated[EvaluationOptions, tyro.conf.arg(name="")] = EvaluationOptions()
    task: int = 0
    """Index of the task in its set."""
    after: tuple[int, ...] = (0, 250)
    """Numbers of episodes that the agent has learned from when episodes are shown; 0 is before any
    adaptation, and the last one at most `--episodes`."""
    shown: int = 4
    """Episodes that are shown each time: the first ones that are played."""
    out: Path | None = None
    """Directory of the pictures; None: `DIR/render`."""
    family: str | None = None
    """The run's family as `module:name`, if it is your own."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    options = parse(Options, "render", arguments)
    enable_compilation_cache()
    written = film.render(
        options.run,
        options.evaluation.build(),
        task=options.task,
        after=options.after,
        shown=options.shown,
        out=options.out,
        family=options.family,
    )
    for path in written:
        print(path)
