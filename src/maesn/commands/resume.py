"""`maesn resume DIR`: go on with a run from its latest checkpoint."""

import dataclasses
from pathlib import Path

import tyro

from maesn import api
from maesn.commands.options import parse
from maesn.runs.compilation import enable_compilation_cache
from maesn.runs.serialization import values_of_words
from maesn.storage import refusals


@dataclasses.dataclass(frozen=True)
class Options:
    """Go on with a run from its latest checkpoint, as if it had never stopped."""

    run: tyro.conf.Positional[Path]
    """Directory of the run."""
    iterations: int | None = None
    """Total number of meta-iterations; None: what the run was started with."""
    family: str | None = None
    """The run's family as `module:name`, if it is your own."""
    change: tuple[str, ...] = ()
    """Settings that are to differ from here on, as NAME=VALUE: `num_threads=2 reward=sparse
    trust_region.damping=0.1`. `config.json` keeps a record of it."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    options = parse(Options, "resume", arguments)
    enable_compilation_cache()
    with refusals("`--change`: "):
        change = values_of_words(options.change)
    run = api.resume(options.run, options.iterations, family=options.family, change=change)
    # Of a run that was begun in Python, the command alone knows where the family is.
    own = f" --family {options.family}" if options.family else run.settings.family_option
    next_command = f"maesn adapt {run.directory}{own}"
    print(f"trained: {run.directory}\nnext:    {next_command}")
