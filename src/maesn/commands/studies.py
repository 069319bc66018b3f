"""Commands that compare: methods on the same tasks, and MAESN with parts left out."""

from pathlib import Path
from typing import Annotated, Any

import tyro

from maesn.commands.options import command
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.running import AnyEvaluation, from_text
from maesn.report.comparison import summary_tables
from maesn.report.tables import print_tables
from maesn.runs.config import RunSettings
from maesn.storage import RunError, refusals
from maesn.studies.ablation import Ablation, ablate, radius_label
from maesn.studies.comparison import NO_SCRATCH, SAME_AS_RUNS, USUAL, Changes
from maesn.studies.comparison import compare as compare_runs
from maesn.studies.lines import Scratch
from maesn.studies.world import WorldSettings


@command
def compare(
    runs: tyro.conf.Positional[tuple[Path, ...]] = (),
    *,
    out: Path = Path("comparison"),
    run_episodes: int | None = None,
    oracle: Path | None = None,
    twice: tuple[str, ...] = (),
    rules: dict[str, str] = {},  # noqa: B006
    world: Annotated[WorldSettings, tyro.conf.arg(name="")] = SAME_AS_RUNS,
    evaluation: AnyEvaluation = USUAL,
    scratch: Annotated[Scratch, tyro.conf.arg(name="")] = NO_SCRATCH,
) -> None:
    """Adapt trained runs and methods from scratch to the same tasks, and compare them.

    With `--then` or `--bonus`, every run that can be given it takes part a second time with it.

    Args:
        runs: Directories of trained runs; those that differ in their seed alone become one line.
        out: Directory of figure, tables and curves; a comparison that was interrupted goes on
            there.
        run_episodes: Episodes per task of trained runs to which nothing is added; None: as many as
            the others. Their steps halve, so there is little to see after twenty updates. Of `rl2`
            an update is an episode.
        oracle: Directory of a run of the preset `oracle`, the ceiling of the score; None: no score.
        twice: Methods of which the runs take part a second time, as in `maesn maml`; none: all that
            can.
        rules: METHOD RULE ...: the rule of all runs of a method, as in `--rules maml "gradient
            step_scale=2"`.
    """
    if evaluation.rule is not None:
        raise RunError("say of which method, as in `--rules maesn gradient`, instead of `--rule`.")
    of_methods = {method: from_text("rule", text) for method, text in rules.items()}
    done = compare_runs(
        runs,
        out=out,
        evaluation=evaluation.changed(wrappers=()),
        run_episodes=run_episodes,
        scratch=scratch,
        world=world,
        oracle=oracle,
        changes=Changes(evaluation.wrappers, twice, of_methods),
        say=print,
    )
    print_tables(summary_tables(done))


@command
def ablation(
    *,
    out: Path = Path("runs/ablation"),
    family: str = "wheeled",
    iterations: int = 300,
    meta_batch_size: int = 20,
    episodes_per_task: int = 20,
    training_seed: int = 0,
    only: tuple[str, ...] = (),
    radii: tuple[float, ...] = (),
    oracle: Path | None = None,
    evaluation: Annotated[Evaluation, tyro.conf.arg(name="")] = USUAL,
) -> None:
    """Train MAESN and MAML with parts left out, adapt them to unseen sparse tasks, compare them.

    Args:
        out: Directory of runs, figures and tables; an ablation that was interrupted goes on there.
        family: Family of tasks.
        iterations: Meta-iterations of every run.
        meta_batch_size: Training tasks per meta-iteration.
        episodes_per_task: Episodes that are played of each task before, and again after, an inner
            update.
        training_seed: Of the training. Seeds that were trained before under the same `--out` join
            the figure.
        oracle: Directory of a run of the preset `oracle`, the ceiling of the score; None: no score.
        only: Names of some lines of the figure; none for all.
        radii: Sparse radii of the new tasks, in metres; a figure for each. Left out: on `wheeled`
            0.8 and 1, as in the published figure; elsewhere the family's own.
    """
    counts: dict[str, Any] = {"iterations": iterations, "episodes_per_task": episodes_per_task}
    with refusals():
        settings = RunSettings(family=family, seed=training_seed, **counts)
        asked = Ablation(settings, only, {"meta_batch_size": meta_batch_size})
    done = ablate(asked, out, evaluation=evaluation, radii=radii, oracle=oracle, say=print)
    for radius, comparison in done.items():
        print(f"Sparse reward, {radius_label(radius)}")
        print_tables(summary_tables(comparison))
