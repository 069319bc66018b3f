"""`maesn compare DIR [DIR...]`: all methods on the same tasks, in one figure and one table."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from maesn.commands.evaluation import EvaluationOptions
from maesn.commands.options import parse
from maesn.evaluation.naming import rule_from_text
from maesn.report.comparison import summary_tables
from maesn.report.tables import print_tables
from maesn.runs.compilation import enable_compilation_cache
from maesn.storage import RunError
from maesn.studies.comparison import NO_SCRATCH, SAME_AS_RUNS, Changes, compare
from maesn.studies.lines import Scratch
from maesn.studies.world import WorldSettings


@dataclasses.dataclass(frozen=True)
class Options:
    """Adapt trained runs and methods from scratch to the same tasks, and compare them.

    With `--then` or `--bonus`, every run that can be given it takes part a second time with it.
    """

    runs: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Directories of trained runs; those that differ in their seed alone become one line."""
    out: Path = Path("comparison")
    """Directory of figure, tables and curves; a comparison that was interrupted goes on there."""
    world: Annotated[WorldSettings, tyro.conf.arg(name="")] = SAME_AS_RUNS
    evaluation: Annotated[EvaluationOptions, tyro.conf.arg(name="")] = EvaluationOptions()
    run_episodes: int | None = None
    """Episodes per task of trained runs to which nothing is added; None: as many as the others.
    Their steps halve, so there is little to see after twenty updates. Of `rl2` an update is an
    episode."""
    scratch: Annotated[Scratch, tyro.conf.arg(name="")] = NO_SCRATCH
    oracle: Path | None = None
    """Directory of a run of the preset `oracle`, the ceiling of the score; None: no score."""
    twice: tuple[str, ...] = ()
    """Methods of which the runs take part a second time, as in `maesn maml`; none: all that can."""
    rules: dict[str, str] = dataclasses.field(default_factory=dict)
    """METHOD RULE ...: the rule of all runs of a method, as in `--rules maml "gradient
    step_scale=2"`."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    options = parse(Options, "compare", arguments)
    enable_compilation_cache()
    asked = options.evaluation.build()
    if asked.rule is not None:
        raise RunError("say of which method, as in `--rules maesn gradient`, instead of `--rule`.")
    rules = {method: rule_from_text(text) for method, text in options.rules.items()}
    compared = compare(
        options.runs,
        out=options.out,
        evaluation=dataclasses.replace(asked, wrappers=()),
        run_episodes=options.run_episodes,
        scratch=options.scratch,
        world=options.world,
        oracle=options.oracle,
        changes=Changes(asked.wrappers, options.twice, rules),
        say=print,
    )
    print_tables(summary_tables(compared))
