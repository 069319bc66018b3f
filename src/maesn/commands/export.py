"""`maesn export DIR policy.npz`: write a trained policy for `maesn.runtime`."""

import dataclasses
from pathlib import Path

import tyro

from maesn import api
from maesn.commands.options import parse


@dataclasses.dataclass(frozen=True)
class Options:
    """Write a trained policy as one file for the NumPy runtime."""

    run: tyro.conf.Positional[Path]
    """Directory of the run, or the name of a policy that comes with the library (`maesn list`). A
    directory of that name in the current folder wins."""
    path: tyro.conf.Positional[Path]
    """File to write, `.npz`."""
    family: str | None = None
    """The run's family as `module:name`, if it is your own."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    options = parse(Options, "export", arguments)
    print(api.export(options.run, options.path, family=options.family))
