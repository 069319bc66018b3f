"""`maesn render DIR --task 3 --update 0 5`: film a trained policy in a new task."""

import dataclasses
from pathlib import Path

import tyro

from maesn.commands.options import parse
from maesn.envs import RewardKind
from maesn.evaluation import film
from maesn.runs.compilation import enable_compilation_cache


@dataclasses.dataclass(frozen=True)
class Options:
    """Film how a trained policy explores a new task, and what it does after adapting to it."""

    run: tyro.conf.Positional[Path]
    """Directory of the run, whose last checkpoint is adapted, or the name of a policy that comes
    with the library (`maesn list`). A directory of that name in the current folder wins; without
    one, files go to `maesn-NAME` there, a run directory like any other."""
    task: int = 0
    """Index of the task in its set."""
    update: tuple[int, ...] = (0, 5)
    """Numbers of updates after which episodes are shown; 0 is before any adaptation."""
    reward: RewardKind = "sparse"
    """Reward in the new task."""
    tasks: str = "test"
    """test, validation, training, ood, or an `.npz` file."""
    episodes: int = 4
    """Episodes that are shown after each of these updates: the first ones that are played."""
    episodes_per_task: int = 50
    """Episodes that are played; an update learns from all of them."""
    seed: int = 0
    """Of the episodes."""
    out: Path | None = None
    """Directory of the pictures; None: `DIR/render`."""
    family: str | None = None
    """The run's family as `module:name`, if it is your own."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    options = parse(Options, "render", arguments)
    enable_compilation_cache()
    settings = {field.name: getattr(options, field.name) for field in dataclasses.fields(options)}
    directory = settings.pop("run")
    for path in film.render(directory, **settings):
        print(path)
