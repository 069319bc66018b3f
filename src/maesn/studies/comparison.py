"""Methods adapted to the same tasks: trained runs, methods from scratch, baselines and oracle."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.tables import write_rows
from maesn.report.adaptation_table import Line
from maesn.report.comparison import Comparison, summary_tables, tidy_rows
from maesn.report.figures.adaptation import plot_comparison
from maesn.report.reading import read_adaptation
from maesn.report.runs import read_run
from maesn.report.series import group_series
from maesn.report.style import METHOD_STYLES, save_figure
from maesn.report.tables import write_tables
from maesn.rules import AbstractRule, AbstractWrapper
from maesn.runs.run import Run
from maesn.storage import RunError, explained
from maesn.studies.curves import Say, curves_of
from maesn.studies.lines import LineSpec, Scratch, baseline_lines, line_of_runs, scratch_lines
from maesn.studies.world import (
    ComparisonWorld,
    WorldSettings,
    check_world,
    comparison_world,
    open_oracle,
)

TABLE, SUMMARY, FIGURE, CURVES = "table.csv", "summary.md", "comparison", "curves"


def silent(sentence: str) -> None:
    """Print nothing."""


class Changes(NamedTuple):
    """What is changed about whom in the new tasks. By default nothing."""

    wrappers: tuple[AbstractWrapper, ...] = ()
    """If there are any, runs take part a second time, with these."""
    twice: Sequence[str] = ()
    """Runs of which methods do; empty for all that can be given them."""
    rules: Mapping[str, AbstractRule] = MappingProxyType({})
    """Rules of all runs of a method, by its name, also where they take part a second time. Methods
    that are not named follow their own."""


SAME_AS_RUNS, NO_SCRATCH, USUAL, UNCHANGED = WorldSettings(), Scratch(), Evaluation(), Changes()


def compare(
    runs: Sequence[str | Path | Run] = (),
    *,
    out: str | Path,
    evaluation: Evaluation = USUAL,
    run_episodes: int | None = None,
    scratch: Scratch = NO_SCRATCH,
    world: WorldSettings = SAME_AS_RUNS,
    oracle: str | Path | None = None,
    changes: Changes = UNCHANGED,
    say: Say = silent,
) -> Comparison:
    """Adapt methods to the same tasks; write curves, a figure and tables.

    What was adapted before in the same way is not repeated: neither the tables that `adapt` has
    left in the runs' directories, nor what an earlier, perhaps interrupted comparison has left in
    `out`.

    Args:
        runs: trained runs or their directories, each with its latest checkpoint. Those that differ
            in their seed alone become one line.
        out: directory for all that is written.
        evaluation: tasks, reward, budgets; a rule and wrappers belong to `changes`.
        run_episodes: episodes per task of trained runs to which nothing is added; None: as many as
            the others. Their steps halve, so there is little to see after twenty updates.
        scratch: methods that have learned nothing before.
        world: family and variant.
        oracle: directory of a run of the preset `oracle`; without it there is no score.
        changes: of how the runs take part, and of which do a second time.
        say: receives messages of progress.

    Raises:
        RunError: a setting, a run or a directory cannot be used.
    """
    own = world.family if world.family and ":" in world.family else None
    opened = [one if isinstance(one, Run) else Run.open(one, family=own) for one in runs]
    ceiling = None if oracle is None else open_oracle(oracle, own)
    settings = world.settings(opened, evaluation)
    _check_changes(changes, opened)
    if ceiling and any(run.settings.method == ceiling.settings.method for run in opened):
        raise RunError(
            "an oracle is among the runs, and --oracle names one as well: give one of the two."
        )
    with closing(comparison_world(settings, evaluation, opened)) as opened_world:
        check_world([*opened, *([ceiling] if ceiling else [])], opened_world)
        lines = _lines_of_runs(opened, opened_world, run_episodes, changes, say)
        lines += scratch_lines(scratch, opened_world)
        if not lines:
            raise RunError("name at least one run directory, or a method with --scratch.")
        return compare_lines(lines, opened_world, Path(out), oracle=ceiling, say=say)


def compare_lines(
    specs: Sequence[LineSpec],
    world: ComparisonWorld,
    out: Path,
    *,
    oracle: Run | None = None,
    say: Say = silent,
) -> Comparison:
    """Adapt all lines, baselines and oracle; write curves, a figure and tables to `out`."""
    adapted = partial(_adapted, world=world, directory=out / CURVES, say=say)
    ceiling = None
    if oracle is not None:
        # Its updates change nothing: the start says all.
        start = dataclasses.replace(world.evaluation, episodes=0)
        ceiling = adapted(line_of_runs("oracle", METHOD_STYLES["oracle"], [oracle], world, start))
    comparison = Comparison(
        lines=tuple(map(adapted, specs)),
        horizon=world.env.horizon,
        baselines=tuple(map(adapted, baseline_lines(world))),
        oracle=ceiling,
    )
    with explained("make", out):
        out.mkdir(parents=True, exist_ok=True)
    write_rows(out / TABLE, tidy_rows(comparison))
    write_tables(summary_tables(comparison), out / SUMMARY)
    for path in (*save_figure(plot_comparison(comparison), out, FIGURE), out / TABLE):
        say(str(path))
    return comparison


def _check_changes(changes: Changes, runs: Sequence[Run]) -> None:
    """Refuse changes that would never show."""
    known = sorted({run.settings.method for run in runs})
    named: dict[str, Iterable[str]] = {"twice": changes.twice, "rules": changes.rules}
    for name, methods in named.items():
        unknown = [method for method in methods if method not in known]
        if unknown:
            raise RunError(
                f"`{name}` must be methods of the runs, "
                f"{', '.join(known) or 'of which there are none'}; got {', '.join(unknown)}."
            )
    if changes.wrappers and not runs:
        raise RunError(
            "`then` and `bonus` add to trained runs, of which none take part: name their "
            "directories, or leave it out."
        )
    if changes.twice and not changes.wrappers:
        raise RunError(
            "`twice` says which runs take part a second time, but nothing is added to them: say "
            "what with `then` or `bonus`."
        )


def _lines_of_runs(
    runs: Sequence[Run],
    world: ComparisonWorld,
    run_episodes: int | None,
    changes: Changes,
    say: Say,
) -> list[LineSpec]:
    by_path = {run.directory: run for run in runs}
    lines: list[LineSpec] = []
    for series in group_series([read_run(run.directory) for run in runs]):
        members = [by_path[one.path] for one in series.runs]
        method = members[0].settings.method
        line = partial(line_of_runs, series.name, series.style, members, world)
        rule = changes.rules.get(method)
        episodes = world.evaluation.budget.episodes if run_episodes is None else run_episodes
        lines.append(line(world.evaluation.changed(rule=rule, episodes=episodes)))
        if not changes.wrappers or (changes.twice and method not in changes.twice):
            continue
        second = world.evaluation.changed(rule=rule, wrappers=changes.wrappers)
        try:
            lines.append(line(second))
        except RunError as error:
            if method in changes.twice:
                raise
            say(f"{series.label} takes part as it is: {error}")
    return lines


def _adapted(spec: LineSpec, world: ComparisonWorld, directory: Path, say: Say) -> Line:
    """Adapt the learners of a line, and read their curves."""
    evaluation, tables = world.evaluation, []
    for one in spec.learners:
        updates = one.record["episodes"] // evaluation.budget.per_update
        table = read_adaptation(curves_of(one, world, directory, say))
        tables.append(
            dataclasses.replace(
                table.first_part(one.num_tasks, updates),
                tasks=evaluation.tasks,
                reward=evaluation.reward,
                trial_episodes=spec.trial_episodes,
            )
        )
    seeds = tuple(one.seed for one in spec.learners)
    return Line(spec.name, spec.style, seeds, tuple(tables), spec.training_steps)
