"""Methods adapted to the same tasks: trained runs, methods from scratch, baselines and oracle."""

import dataclasses
from collections.abc import Iterable, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

from maesn.api import changed
from maesn.envs import Variant
from maesn.evaluation.evaluation import Evaluation
from maesn.report.adaptation_table import Line
from maesn.report.comparison import Comparison, write_tidy_table
from maesn.report.comparison_tables import write_summary
from maesn.report.figures.adaptation import plot_comparison
from maesn.report.reading import read_adaptation
from maesn.report.runs import read_run
from maesn.report.series import group_series
from maesn.report.style import METHOD_STYLES, save_figure
from maesn.runs.config import RunSettings, make_env
from maesn.runs.run import Run
from maesn.runs.task_sources import find_tasks, resolve_family
from maesn.storage import RunError, explained
from maesn.studies.checks import Changes, check_changes, check_world, open_oracle
from maesn.studies.curves import ComparisonWorld, Say, curves_of, open_comparison_world
from maesn.studies.lines import LineSpec, Scratch, baseline_lines, line_of_runs, scratch_lines


def silent(sentence: str) -> None:
    """Print nothing."""


TABLE, SUMMARY, FIGURE, CURVES = "table.csv", "summary.md", "comparison", "curves"


@dataclasses.dataclass(frozen=True)
class WorldSettings:
    """The family of a comparison; what is None is what the runs that are compared say."""

    family: str | None = None
    """Family of tasks, or `module:name` of your own."""
    variant: Variant | None = None
    """Rewards of the code behind the published curves, or as printed in the paper."""

    def settings(self, runs: Iterable[Run], evaluation: Evaluation) -> RunSettings:
        """Return the settings of a world in which the runs can be compared.

        Raises:
            RunError: nothing says which family it is, or the runs disagree.
        """
        asked = {
            "family": self.family,
            "variant": self.variant,
            "sparse_radius": evaluation.sparse_radius,
            "engine": evaluation.engine,
        }
        found = {
            name: list(dict.fromkeys(_of_run(run, name) for run in runs))
            for name, value in asked.items()
            if value is None
        }
        for name, values in found.items():
            if len(values) > 1:
                listed = " and ".join(map(str, sorted(values, key=str)))
                raise RunError(
                    f"the runs must agree in `{name}` to be compared, got {listed}: say which one "
                    f"with --{name.replace('_', '-')}, or compare fewer runs."
                )
        given: dict[str, Any] = {name: value for name, value in asked.items() if value is not None}
        given |= {name: values[0] for name, values in found.items() if values}
        if "family" not in given:
            raise RunError("`family` must be given where no run says it: --family NAME.")
        return RunSettings(**given, num_threads=evaluation.num_threads or 0)


def _of_run(run: Run, name: str) -> Any:
    """Return what a run says of its world: the values that it was trained with, not defaults."""
    if name == "family":
        return run.settings.own_family or run.config.family
    if name == "engine":
        return run.settings.engine
    return getattr(run.env(), name) or None  # a radius of 0 cannot be asked for


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
    check_changes(changes, opened)
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


def comparison_world(
    settings: RunSettings, evaluation: Evaluation, runs: Sequence[Run] = ()
) -> ComparisonWorld:
    """Open the world of a comparison; it is to be closed.

    Args:
        settings: variant, sparse radius, engine and threads.
        evaluation: of all lines.
        runs: that are compared. Their recorded world is played in, whatever has become of the
            family's defaults since.
    """
    family = resolve_family(settings.family)
    if runs and runs[0].env().variant == settings.variant:
        env = runs[0].env(evaluation.reward, settings.sparse_radius)
    else:
        env = make_env(family, settings, evaluation.reward)
    return open_comparison_world(env, find_tasks(evaluation.tasks, family), settings, evaluation)


def compare_lines(
    specs: Sequence[LineSpec],
    world: ComparisonWorld,
    out: Path,
    *,
    oracle: Run | None = None,
    say: Say = silent,
) -> Comparison:
    """Adapt all lines, baselines and oracle; write curves, a figure and tables.

    Args:
        specs: the lines of the comparison.
        world: in which they are compared.
        out: directory for all that is written.
        oracle: a run that is given the tasks.
        say: receives messages of progress.
    """

    def line(spec: LineSpec) -> Line:
        return _line(spec, world, out / CURVES, say)

    ceiling = None
    if oracle is not None:
        # Its updates change nothing: the start says all.
        start = dataclasses.replace(world.evaluation, episodes=0)
        ceiling = line_of_runs("oracle", METHOD_STYLES["oracle"], [oracle], world, start)
    comparison = Comparison(
        lines=tuple(map(line, specs)),
        horizon=world.env.horizon,
        baselines=tuple(map(line, baseline_lines(world))),
        oracle=None if ceiling is None else line(ceiling),
    )
    with explained("make", out):
        out.mkdir(parents=True, exist_ok=True)
    write_tidy_table(comparison, out / TABLE)
    write_summary(comparison, out / SUMMARY)
    for path in (*save_figure(plot_comparison(comparison), out, FIGURE), out / TABLE):
        say(str(path))
    return comparison


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
        episodes = world.evaluation.episodes if run_episodes is None else run_episodes
        lines.append(line(changed(world.evaluation, {"rule": rule, "episodes": episodes})))
        if not changes.second_time(method):
            continue
        second = changed(world.evaluation, {"rule": rule, "wrappers": changes.wrappers})
        try:
            lines.append(line(second))
        except RunError as error:
            if method in changes.twice:
                raise
            say(f"{series.label} takes part as it is: {error}")
    return lines


def _line(spec: LineSpec, world: ComparisonWorld, directory: Path, say: Say) -> Line:
    tables = [
        read_adaptation(curves_of(one, world, directory, say)).first_part(
            one.num_tasks, one.record["episodes"] // world.evaluation.episodes_per_update
        )
        for one in spec.learners
    ]
    named = (
        dataclasses.replace(
            table,
            tasks=world.evaluation.tasks,
            reward=world.evaluation.reward,
            trial_episodes=spec.trial_episodes,
        )
        for table in tables
    )
    seeds = tuple(one.seed for one in spec.learners)
    return Line(spec.name, spec.style, seeds, tuple(named), spec.training_steps)
