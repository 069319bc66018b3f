"""`maesn plot DIR [DIR...]`: draw the paper's figures."""

import dataclasses
from pathlib import Path

import tyro

from maesn import api
from maesn.commands.options import parse
from maesn.runs.compilation import enable_compilation_cache
from maesn.storage import RunError


@dataclasses.dataclass(frozen=True)
class Options:
    """Draw the paper's figures from one or several runs."""

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Directories of the runs, or names of policies that come with the library (`maesn list`);
    several are compared in one figure. A directory of that name in the current folder wins; without
    one, files go to `maesn-NAME` there, a run directory like any other."""
    out: Path | None = None
    """Where the figures go; None: `figures` in the first run's directory."""
    family: str | None = None
    """The runs' family as `module:name`, if it is your own."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    options = parse(Options, "plot", arguments)
    if not options.runs:
        raise RunError("name at least one run directory: maesn plot DIR [DIR ...]")
    enable_compilation_cache()
    for path in api.plot(options.runs, options.out, family=options.family):
        print(path)
