"""`maesn demo`: the library's main job from end to end, in under five minutes on two cores."""

import dataclasses
from pathlib import Path

from maesn import api
from maesn.commands.options import parse
from maesn.learners import maesn
from maesn.report import print_adaptation_summary
from maesn.runs.compilation import enable_compilation_cache
from maesn.runs.config import RunSettings

CONFIG = "config.json"


@dataclasses.dataclass(frozen=True)
class Options:
    """Train MAESN on the wheeled robot, adapt it to unseen sparse tasks, draw the figures."""

    run: Path = Path("runs/demo")
    """Directory of the run; a demo that was interrupted goes on where it stopped."""
    iterations: int = 150
    """Meta-iterations. 300 explore better and take twice as long."""
    seed: int = 0
    """Every random draw of the run follows from this number."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    options = parse(Options, "demo", arguments)
    enable_compilation_cache()
    print(f"1. MAESN learns to explore: {options.iterations} meta-iterations on dense reward")
    if (options.run / CONFIG).exists():
        api.resume(options.run, options.iterations)
    else:
        settings = RunSettings(iterations=options.iterations, seed=options.seed)
        api.train(maesn(), settings, options.run)
    print("2. it adapts to 100 unseen goals on sparse reward, which it is not told")
    outcome = api.adapt(options.run)
    print_adaptation_summary(api.adaptation_file(options.run, "test", "sparse"))
    reached = (outcome.curves.success_rate[:, 0] > 0).mean()
    print(f"goals reached by some of 50 episodes before any adaptation: {reached:.0%}")
    print("3. figures")
    for path in api.plot([options.run]):
        print(path)
