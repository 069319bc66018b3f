"""`maesn compare DIR [DIR...]`: all methods on the same tasks, in one figure and one table."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from maesn.commands.options import parse
from maesn.evaluation.test_time import AtTestTime, FineTuneRule
from maesn.learners.wrappers.curiosity import CuriosityBonus
from maesn.report.comparison_tables import print_summary
from maesn.runs.compilation import enable_compilation_cache
from maesn.storage import RunError
from maesn.studies.checks import Changes
from maesn.studies.comparison import NO_SCRATCH, SAME_AS_RUNS, USUAL, WorldSettings, compare
from maesn.studies.curves import Conditions
from maesn.studies.lines import Scratch


@dataclasses.dataclass(frozen=True)
class Options:
    """Adapt trained runs and methods from scratch to the same tasks, and compare them."""

    runs: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Directories of trained runs; those that differ in their seed alone become one line."""
    out: Path = Path("comparison")
    """Directory of figure, tables and curves; a comparison that was interrupted goes on there."""
    place: Annotated[WorldSettings, tyro.conf.arg(name="")] = SAME_AS_RUNS
    conditions: Annotated[Conditions, tyro.conf.arg(name="")] = USUAL
    scratch: Annotated[Scratch, tyro.conf.arg(name="")] = NO_SCRATCH
    oracle: Path | None = None
    """Directory of a run of the preset `oracle`, the ceiling of the score; None: no score."""
    fine_tune: FineTuneRule | None = None
    """Every run takes part a second time, its policy fine-tuned like this in the updates beyond
    --after; None: it is not."""
    fine_tune_size: float | None = None
    """Of the updates that fine-tune: trpo's bound on the mean KL divergence, or reinforce's step
    size; None: the usual, 0.01 and 0.1."""
    after: int = 10
    """Updates of a run's own learner before its policy is fine-tuned."""
    curious: bool = False
    """Every run takes part a second time, paid for what it finds out as well, by
    --curiosity-weight. With --fine-tune the same second time is both."""
    twice: tuple[str, ...] = ()
    """Methods of which the runs take part a second time, as in `maesn maml`; none: all that can."""
    step_scales: dict[str, float] = dataclasses.field(default_factory=dict)
    """METHOD NUMBER ...: multiplies the sizes of all steps that the runs of a method take in the
    new tasks, as in `maml 2`."""
    full_steps: dict[str, int] = dataclasses.field(default_factory=dict)
    """METHOD NUMBER ...: so many updates of a method's runs have the whole step size, before the
    sizes begin to shrink."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    options = parse(Options, "compare", arguments)
    enable_compilation_cache()
    print_summary(
        compare(
            options.runs,
            out=options.out,
            scratch=options.scratch,
            place=options.place,
            conditions=options.conditions,
            oracle=options.oracle,
            changes=_changes(options),
            say=print,
        )
    )


def _changes(options: Options) -> Changes:
    """Return what is changed about whom in the new tasks."""
    scales, steps = options.step_scales, options.full_steps
    try:
        test_time = AtTestTime(
            fine_tune=options.fine_tune,
            fine_tune_size=options.fine_tune_size,
            after=options.after,
            curious=options.curious,
            curiosity=CuriosityBonus(options.scratch.curiosity_weight),
        )
        paces = {
            method: AtTestTime(step_scale=scales.get(method, 1.0), full_steps=steps.get(method))
            for method in {**scales, **steps}
        }
    except ValueError as error:
        raise RunError(str(error)) from error
    return Changes(test_time, options.twice, paces)
