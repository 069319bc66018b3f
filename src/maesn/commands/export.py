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
    latents: Path | None = None
    """Latents that `maesn adapt` wrote (`.latents.npz`): the robot starts at the adapted latent of
    a task instead of the prior, with the step sizes that `maesn adapt --start` would go on with."""
    task: int | None = None
    """Index of that task, in the set that was adapted to."""
    family: str | None = None
    """The run's family as `module:name`, if it is your own."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    options = parse(Options, "export", arguments)
    print(
        api.export(
            options.run,
            options.path,
            options.family,
            latents=options.latents,
            task=options.task,
        )
    )
