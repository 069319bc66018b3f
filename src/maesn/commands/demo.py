"""`maesn demo`: the library's main job from end to end, in under five minutes on two cores."""

import dataclasses
from pathlib import Path

from maesn import api
from maesn.commands.options import parse
from maesn.learners import recommended
from maesn.report import print_adaptation_summary
from maesn.runs.compilation import enable_compilation_cache
from maesn.runs.config import CONFIG, RunSettings
from maesn.runs.run import Run
from maesn.storage import RunError, refusals


@dataclasses.dataclass(frozen=True)
class Options:
    """Train MAESN on the wheeled robot, adapt it to unseen sparse tasks, draw the figures."""

    run: Path = Path("runs/demo")
    """Directory of the run; a demo that was interrupted goes on where it stopped."""
    iterations: int = 80
    """Meta-iterations. 300 explore better, in three times as long."""
    seed: int = 0
    """Every random draw of the run follows from this number."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    options = parse(Options, "demo", arguments)
    enable_compilation_cache()
    print(f"1. MAESN learns to explore: {options.iterations} meta-iterations on dense reward")
    with refusals():
        settings = RunSettings(iterations=options.iterations, seed=options.seed)
    if (options.run / CONFIG).exists():
        _check_same(Run.open(options.run), settings)
        api.resume(options.run, options.iterations)
    else:
        api.train(recommended("maesn", settings.family), settings, options.run)
    print("2. it adapts to 100 unseen goals, which it does not see, on sparse reward")
    done = api.adapt(options.run)
    print_adaptation_summary(done.table)
    reached = (done.curves.success_rate[:, 0] > 0).mean()
    print(f"goals reached by some of 50 episodes before any adaptation: {reached:.0%}")
    print("3. figures")
    for path in api.plot([options.run]):
        print(path)


def _check_same(run: Run, settings: RunSettings) -> None:
    """Refuse to go on with a run that is not this demo's."""
    found = (run.settings.method, run.settings.family, run.settings.seed)
    wanted = ("maesn", settings.family, settings.seed)
    if found != wanted:
        raise RunError(
            f"`{run.directory}` holds a run of {found[0]} on {found[1]} with seed {found[2]}, not "
            f"of {wanted[0]} on {wanted[1]} with seed {wanted[2]}: give another `--run`."
        )
