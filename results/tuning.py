"""Choose every method's configuration on the validation tasks of `wheeled`.

    python results/tuning.py runs --out tuning > results/wheeled/tuning.md

Every method of the comparison has three configurations, each with one seed. The first is its
default, which stays unless another one is better by more than a standard error of their difference,
task by task: with so few tasks the highest mean alone is often chance. Of the methods that take
steps in a new task, the run `runs/METHOD` takes part with its own steps, with more full steps
before they halve, and with longer ones; `rl2`, which takes none, with three runs that differ in
`--policy-step.descent.learning-rate`; methods from scratch with three sizes of their step, or of
the curiosity. What is finished is not repeated.
"""

import dataclasses
import math
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import tyro

from maesn.evaluation.evaluation import Evaluation
from maesn.report.adaptation_table import Line
from maesn.report.tables import markdown_row
from maesn.rules import GradientRule
from maesn.studies.comparison import Changes, compare
from maesn.studies.lines import Scratch
from maesn.studies.world import WorldSettings

STEPPING = ("maesn", "latent_space", "maml", "maml_bias", "maml_bias_only")
PACES = {
    "as trained": GradientRule(),
    "10 full steps": GradientRule(full_steps=10),
    "steps x 2": GradientRule(step_scale=2.0),
}
RECURRENT = {
    "learning rate 1e-3": "rl2",
    "learning rate 3e-3": "rl2-3e-3",
    "learning rate 3e-4": "rl2-3e-4",
}
SCRATCH = {
    "reinforce": {f"step {x}": Scratch(("reinforce",), step_size=x) for x in (0.1, 0.03, 0.3)},
    "trpo": {f"max KL {x}": Scratch(("trpo",), max_kl=x) for x in (0.01, 0.02, 0.05)},
    "vime": {f"weight {x:g}": Scratch(("vime",), curiosity_weight=x) for x in (1e-4, 1e-3, 1e-2)},
}
TRAINED = Evaluation(tasks="validation", num_tasks=30, episodes=500)
FROM_SCRATCH = Evaluation(tasks="validation", num_tasks=10, episodes=5000)


@dataclasses.dataclass(frozen=True)
class Settings:
    """Where runs are, and where curves go."""

    runs: tyro.conf.Positional[Path]
    """Directory of the runs, each by the name of its method."""
    out: Path
    """Directory of the curves."""
    only: tuple[str, ...] = ()
    """Methods; empty for all."""


def tell(sentence: str) -> None:
    """Say what goes on, aside from the table."""
    print(sentence, file=sys.stderr, flush=True)


def configurations(method: str, settings: Settings) -> dict[str, Line]:
    """Adapt a method with each of its configurations."""
    adapted = partial(compare, out=settings.out / method, say=tell)
    trained = partial(adapted, evaluation=TRAINED)
    if method in SCRATCH:
        wheeled = WorldSettings(family="wheeled")
        fresh = partial(adapted, world=wheeled, evaluation=FROM_SCRATCH)
        found = {name: fresh(scratch=scratch) for name, scratch in SCRATCH[method].items()}
    elif method == "rl2":
        found = {name: trained([settings.runs / run]) for name, run in RECURRENT.items()}
    else:
        run = settings.runs / method
        paced = {name: Changes(rules={method: pace}) for name, pace in PACES.items()}
        found = {name: trained([run], changes=changes) for name, changes in paced.items()}
    return {name: compared.lines[0] for name, compared in found.items()}


def standard_error(values: np.ndarray) -> float:
    """Return the standard error of a mean."""
    return float(values.std(ddof=1)) / math.sqrt(len(values))


def chosen(ends: dict[str, np.ndarray]) -> str:
    """Return the best configuration, or the first where none is better beyond chance.

    Args:
        ends: the last return in each task, by configuration.
    """
    default, best = next(iter(ends)), max(ends, key=lambda name: ends[name].mean())
    gain = ends[best] - ends[default]
    return best if gain.mean() > standard_error(gain) else default


def last_prepared(line: Line) -> int:
    """Return the last update, of methods with memory the last that they were trained for."""
    beyond = line.table.first_beyond
    return len(line.table.updates) - 1 if beyond is None else beyond - 1


def rows(method: str, lines: dict[str, Line]) -> Iterator[str]:
    """Yield rows of Markdown, the chosen configuration bold."""
    last = {name: last_prepared(line) for name, line in lines.items()}
    ends = {name: line.measure("mean_return")[0, :, last[name]] for name, line in lines.items()}
    kept = chosen(ends)
    for name, end in ends.items():
        line, error = lines[name], standard_error(end)
        success = 100 * line.measure("success_rate")[0, :, last[name]].mean()
        cells = (
            f"`{method}`",
            f"**{name}**" if name == kept else name,
            len(end),
            line.table.updates[last[name]],
            f"{end.mean():.1f} ± {error:.1f}",
            f"{success:.1f}",
        )
        yield markdown_row([str(cell) for cell in cells])


def main() -> None:
    """Print the table as Markdown."""
    settings = tyro.cli(Settings)
    print("# The configuration of every method, chosen on validation tasks\n")
    print("| method | configuration | tasks | updates | sparse return | reaches goal (%) |")
    print("|---|---|---:|---:|---:|---:|")
    for method in settings.only or (*STEPPING, "rl2", *SCRATCH):
        for row in rows(method, configurations(method, settings)):
            print(row, flush=True)
    print(
        "\nAfter the last update (of `rl2`, the last that its trials had); ± one standard error "
        "over tasks, of one seed; share of episodes. Bold: chosen. The first is the default, which "
        "stays unless the best is better by more than a standard error of their difference, task "
        "by task."
    )


if __name__ == "__main__":
    main()
