"""`maesn ablation`: the paper's last figure, from training to the table."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from maesn.commands.options import parse
from maesn.evaluation.evaluation import Evaluation
from maesn.report.comparison import summary_tables
from maesn.report.tables import print_tables
from maesn.runs.compilation import enable_compilation_cache
from maesn.runs.config import RunSettings
from maesn.storage import refusals
from maesn.studies.ablation import Ablation, ablate, radius_label
from maesn.studies.comparison import USUAL


@dataclasses.dataclass(frozen=True)
class Options:
    """Train MAESN and MAML with parts left out, adapt them to unseen sparse tasks, compare them."""

    out: Path = Path("runs/ablation")
    """Directory of runs, figures and tables; an ablation that was interrupted goes on there."""
    family: str = "wheeled"
    """Family of tasks."""
    iterations: int = 300
    """Meta-iterations of every run."""
    meta_batch_size: int = 20
    """Training tasks per meta-iteration."""
    episodes_per_task: int = 20
    """Episodes that are played of each task before, and again after, an inner update."""
    training_seed: int = 0
    """Of the training. Seeds that were trained before under the same `--out` join the figure."""
    only: tuple[str, ...] = ()
    """Names of some lines of the figure; none for all."""
    radii: tuple[float, ...] = ()
    """Sparse radii of the new tasks, in metres; a figure for each. Left out: on `wheeled` 0.8 and
    1, as in the published figure; elsewhere the family's own."""
    evaluation: Annotated[Evaluation, tyro.conf.arg(name="")] = USUAL
    oracle: Path | None = None
    """Directory of a run of the preset `oracle`, the ceiling of the score; None: no score."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    options = parse(Options, "ablation", arguments)
    enable_compilation_cache()
    done = ablate(
        _asked_for(options),
        options.out,
        evaluation=options.evaluation,
        radii=options.radii,
        oracle=options.oracle,
        say=print,
    )
    for radius, comparison in done.items():
        print(f"Sparse reward, {radius_label(radius)}")
        print_tables(summary_tables(comparison))


def _asked_for(options: Options) -> Ablation:
    with refusals():
        settings = RunSettings(
            family=options.family,
            seed=options.training_seed,
            iterations=options.iterations,
            episodes_per_task=options.episodes_per_task,
        )
        return Ablation(settings, options.only, {"meta_batch_size": options.meta_batch_size})
