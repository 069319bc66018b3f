"""`maesn adapt DIR`: adapt a trained policy to new tasks."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from maesn import api
from maesn.commands.options import parse
from maesn.envs import RewardKind
from maesn.evaluation.tables import adaptation_file, engine_suffix
from maesn.evaluation.test_time import NOTHING_ADDED, AtTestTime
from maesn.report import print_adaptation_summary
from maesn.runs.compilation import enable_compilation_cache
from maesn.runs.shipped import working_copy
from maesn.worlds import EngineName


@dataclasses.dataclass(frozen=True)
class Options:
    """Adapt the last checkpoint of a run to new tasks, and tabulate how it does."""

    run: tyro.conf.Positional[Path]
    """Directory of the run, or the name of a policy that comes with the library (`maesn list`). A
    directory of that name in the current folder wins; without one, files go to `maesn-NAME` there,
    a run directory like any other."""
    reward: RewardKind = "sparse"
    """Reward in the new tasks."""
    updates: int = 10
    """Policy-gradient updates per task."""
    episodes_per_task: int = 50
    """Episodes per task and update."""
    tasks: str = "test"
    """test (report on these), validation (choose on these), training, ood (unlike all of these), or
    an `.npz` file."""
    seed: int = 0
    """Of the episodes."""
    out: Path | None = None
    """Table to write; None: `DIR/adaptation/TASKS-REWARD.csv`. Latents go beside it."""
    start: Path | None = None
    """Latents of an earlier adaptation to the same tasks (`.latents.npz`) to go on from."""
    family: str | None = None
    """The run's family as `module:name`, if it is your own."""
    engine: EngineName | None = None
    """Engine that moves the world, native or mjx; None: the run's own."""
    test_time: Annotated[AtTestTime, tyro.conf.arg(name="")] = NOTHING_ADDED


def main(arguments: list[str]) -> None:
    """Run the command."""
    options = parse(Options, "adapt", arguments)
    enable_compilation_cache()
    settings = {field.name: getattr(options, field.name) for field in dataclasses.fields(options)}
    directory = working_copy(settings.pop("run"))
    outcome = api.adapt(directory, **settings)
    suffix = options.test_time.suffix + engine_suffix(options.engine)
    table = options.out or adaptation_file(
        directory, options.tasks, options.reward, outcome.first_update, suffix
    )
    print_adaptation_summary(table)
    print(f"table: {table}")
