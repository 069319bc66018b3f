"""`maesn compare DIR [DIR...]`: all methods on the same tasks, in one figure and one table."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from maesn.commands.options import parse
from maesn.comparison import ANYWHERE, NOBODY, USUAL, Place, compare
from maesn.entries import Scratch
from maesn.report.comparison_tables import print_summary
from maesn.runs.compilation import enable_compilation_cache
from maesn.runs.contest import Conditions
from maesn.runs.test_time import AtTestTime, FineTuneRule


@dataclasses.dataclass(frozen=True)
class Options:
    """Adapt trained runs and methods from scratch to the same tasks, and compare them."""

    runs: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Directories of trained runs; those that differ in their seed alone become one line."""
    out: Path = Path("comparison")
    """Directory of figure, tables and curves; a comparison that was interrupted goes on there."""
    place: Annotated[Place, tyro.conf.arg(name="")] = ANYWHERE
    conditions: Annotated[Conditions, tyro.conf.arg(name="")] = USUAL
    scratch: tuple[str, ...] = ()
    """Methods that begin anew in every task: trpo, reinforce, vime. NAME:COUNT adapts to the first
    COUNT tasks alone, as in vime:30."""
    scratch_seeds: tuple[int, ...] = NOBODY.seeds
    """Each method from scratch begins anew in every task with each of these seeds."""
    step_size: float = NOBODY.step_size
    """Of reinforce from scratch. Published: 0.1 on `wheeled` and `ant`, 1 on `blockpush`."""
    max_kl: float = NOBODY.max_kl
    """Of trpo and vime from scratch: bound on the mean KL divergence of an update. Published:
    0.01."""
    curiosity_weight: float = NOBODY.curiosity_weight
    """Of vime: what a transition of typical information gain is paid. Published: 1e-4."""
    oracle: Path | None = None
    """Directory of a run of the preset `oracle`, the ceiling of the score; None: no score."""
    fine_tune: FineTuneRule | None = None
    """Every run takes part a second time, its policy fine-tuned like this; None: it does not."""
    fine_tune_only: tuple[str, ...] = ()
    """Methods of which the runs are fine-tuned, as in `maesn maml`; none: all that can be."""
    after: int = 10
    """Updates of a run's own learner before its policy is fine-tuned."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    options = parse(Options, "compare", arguments)
    enable_compilation_cache()
    print_summary(
        compare(
            options.runs,
            out=options.out,
            scratch=Scratch(
                methods=options.scratch,
                seeds=options.scratch_seeds,
                step_size=options.step_size,
                max_kl=options.max_kl,
                curiosity_weight=options.curiosity_weight,
            ),
            place=options.place,
            conditions=options.conditions,
            oracle=options.oracle,
            test_time=AtTestTime(fine_tune=options.fine_tune, after=options.after),
            tuned_methods=options.fine_tune_only,
            say=print,
        )
    )
