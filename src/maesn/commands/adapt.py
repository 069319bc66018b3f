"""`maesn adapt DIR`: adapt a trained policy to new tasks."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from maesn import api
from maesn.commands.evaluation import EvaluationOptions
from maesn.commands.options import parse
from maesn.report import print_adaptation_summary
from maesn.runs.compilation import enable_compilation_cache


@dataclasses.dataclass(frozen=True)
class Options:
    """Adapt the last checkpoint of a run to new tasks, and tabulate how it does."""

    run: tyro.conf.Positional[Path]
    """Directory of the run, or the name of a policy that comes with the library (`maesn list`). A
    directory of that name in the current folder wins; without one, files go to `maesn-NAME` there,
    a run directory like any other."""
    evaluation: Annotated[EvaluationOptions, tyro.conf.arg(name="")] = EvaluationOptions()
    out: Path | None = None
    """Table to write; None: `DIR/adaptation/TASKS-REWARD.csv`. Latents go beside it."""
    start: Path | None = None
    """Latents of an earlier adaptation to the same tasks (`.latents.npz`) to go on from."""
    family: str | None = None
    """The run's family as `module:name`, if it is your own."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    options = parse(Options, "adapt", arguments)
    enable_compilation_cache()
    done = api.adapt(
        options.run,
        options.evaluation.build(),
        out=options.out,
        start=options.start,
        family=options.family,
    )
    print_adaptation_summary(done.table)
    print(f"table:   {done.table}")
    if done.latents is not None:
        print(f"latents: {done.latents}")
