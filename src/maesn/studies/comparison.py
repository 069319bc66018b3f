"""All methods under the same conditions: trained runs, from scratch, baselines and oracle."""

import dataclasses
from collections.abc import Iterable, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path

from maesn.envs import Variant
from maesn.report.comparison import Comparison, write_tidy_table
from maesn.report.comparison_tables import write_summary
from maesn.report.figures.comparison import plot_comparison
from maesn.report.line import Line
from maesn.report.reading import read_adaptation
from maesn.report.runs import read_run
from maesn.report.series import group_series
from maesn.report.style import METHOD_STYLES, save_figure
from maesn.runs.config import RunSettings
from maesn.runs.run import Run
from maesn.runs.task_sources import resolve_family
from maesn.storage import RunError, explained
from maesn.studies.checks import Changes, check_changes, check_world, open_oracle
from maesn.studies.curves import ComparisonWorld, Conditions, Say, curves_of, open_comparison_world
from maesn.studies.lines import LineSpec, Scratch, baseline_lines, line_of_runs, scratch_lines
from maesn.worlds import EngineName


def silent(sentence: str) -> None:
    """Keep to oneself what goes on."""


TABLE, SUMMARY, FIGURE, CURVES = "table.csv", "summary.md", "comparison", "curves"


@dataclasses.dataclass(frozen=True)
class WorldSettings:
    """The world of a comparison; what is None is what the runs that are compared say."""

    family: str | None = None
    """Family of tasks, or `module:name` of your own."""
    variant: Variant | None = None
    """Rewards of the code behind the published curves, or as printed in the paper."""
    sparse_radius: float | None = None
    """Metres around the goal in which sparse reward tells the distance."""
    engine: EngineName | None = None
    """Engine that moves the world, native or mjx."""
    num_threads: int = 0
    """Threads of the physics engine; 0: one for each CPU."""

    def settings(self, runs: Iterable[Run]) -> RunSettings:
        """Return the settings of a world in which the runs can be compared.

        Raises:
            RunError: neither this place nor the runs say which family it is, or the runs disagree.
        """
        said = {
            "family": [self.family] if self.family else [run.config.family for run in runs],
            **{
                name: [getattr(run.settings, name) for run in runs]
                for name in ("variant", "sparse_radius", "engine")
                if getattr(self, name) is None
            },
        }
        for name, values in said.items():
            if len(set(values)) > 1:
                found = " and ".join(map(str, sorted(set(values), key=str)))
                raise RunError(
                    f"the runs must agree in `{name}` to be compared, got {found}: say which one "
                    f"with --{name.replace('_', '-')}, or compare fewer runs."
                )
        if not said["family"]:
            raise RunError("`family` must be given where no run says it: --family NAME.")
        given = {
            name: getattr(self, name)
            for name in ("variant", "sparse_radius", "engine")
            if getattr(self, name) is not None
        }
        first = {name: values[0] for name, values in said.items() if values}
        return RunSettings(**{**first, **given, "num_threads": self.num_threads})


SAME_AS_RUNS, NO_SCRATCH, USUAL, UNCHANGED = WorldSettings(), Scratch(), Conditions(), Changes()


def compare(
    directories: Sequence[str | Path] = (),
    *,
    out: str | Path,
    scratch: Scratch = NO_SCRATCH,
    place: WorldSettings = SAME_AS_RUNS,
    conditions: Conditions = USUAL,
    oracle: str | Path | None = None,
    changes: Changes = UNCHANGED,
    say: Say = silent,
) -> Comparison:
    """Adapt methods to the same tasks; write curves, a figure and tables.

    What was adapted before under the same conditions is not repeated: neither the tables that
    `adapt` has left in the runs' directories, nor what an earlier, perhaps interrupted comparison
    has left in `out`.

    Args:
        directories: of trained runs, each with its latest checkpoint. Those that differ in their
            seed alone become one line.
        out: directory for all that is written.
        scratch: methods that have learned nothing before.
        place: the world.
        conditions: tasks, reward, updates, episodes.
        oracle: directory of a run of the preset `oracle`; without it there is no score.
        changes: of how the runs take part, and of who does a second time.
        say: is told what goes on.

    Raises:
        RunError: a setting, a run or a directory cannot be used.
    """
    own = place.family if place.family and ":" in place.family else None
    runs = [Run.open(path, family=own) for path in directories]
    told = None if oracle is None else open_oracle(oracle, own)
    settings = place.settings(runs)
    check_changes(changes, runs, conditions.updates)
    if told and any(run.settings.method == told.settings.method for run in runs):
        raise RunError(
            "an oracle is among the runs, and --oracle names one as well: give one of the two."
        )
    with closing(comparison_world(settings, conditions)) as ground:
        check_world([*runs, *([told] if told else [])], ground)
        entries = _entries(runs, ground, place.engine, changes, say)
        entries += scratch_lines(scratch, ground)
        if not entries:
            raise RunError("name at least one run directory, or a method with --scratch.")
        return compare_lines(entries, ground, Path(out), oracle=told, say=say)


def comparison_world(settings: RunSettings, conditions: Conditions) -> ComparisonWorld:
    """Return where the settings and conditions say; to be closed."""
    return open_comparison_world(resolve_family(settings.family), settings, conditions)


def compare_lines(
    entries: Sequence[LineSpec],
    ground: ComparisonWorld,
    out: Path,
    *,
    oracle: Run | None = None,
    say: Say = silent,
) -> Comparison:
    """Adapt all entries, baselines and oracle; write curves, a figure and tables.

    Args:
        entries: the lines of the comparison.
        ground: where.
        out: directory for all that is written.
        oracle: a run that is told the tasks.
        say: is told what goes on.
    """

    def line(entry: LineSpec) -> Line:
        return _line(entry, ground, out / CURVES, say)

    told = None
    if oracle is not None:
        # Its updates change nothing: the start says all.
        told = line_of_runs("oracle", METHOD_STYLES["oracle"], [oracle], ground, updates=0)
    comparison = Comparison(
        lines=tuple(map(line, entries)),
        horizon=ground.env.horizon,
        baselines=tuple(map(line, baseline_lines(ground))),
        oracle=None if told is None else line(told),
    )
    with explained("make", out):
        out.mkdir(parents=True, exist_ok=True)
    write_tidy_table(comparison, out / TABLE)
    write_summary(comparison, out / SUMMARY)
    for path in (*save_figure(plot_comparison(comparison), out, FIGURE), out / TABLE):
        say(str(path))
    return comparison


def _entries(
    runs: Sequence[Run],
    ground: ComparisonWorld,
    engine: EngineName | None,
    changes: Changes,
    say: Say,
) -> list[LineSpec]:
    by_path = {run.directory: run for run in runs}
    entries: list[LineSpec] = []
    for series in group_series([read_run(run.directory) for run in runs]):
        members = [by_path[one.path] for one in series.runs]
        entry = partial(line_of_runs, series.name, series.style, members, ground, engine=engine)
        usual, tuned = changes.of(members[0].settings.method)
        entries.append(entry(test_time=usual))
        if tuned is not None:
            try:
                entries.append(entry(test_time=tuned))
            except RunError as error:
                if members[0].settings.method in changes.twice:
                    raise
                say(f"{series.label} takes part as it is: {error}")
    return entries


def _line(entry: LineSpec, ground: ComparisonWorld, directory: Path, say: Say) -> Line:
    tables = [
        read_adaptation(curves_of(contestant, ground, directory, say)).first_part(
            contestant.num_tasks, contestant.record["updates"]
        )
        for contestant in entry.contestants
    ]
    conditions = ground.conditions
    named = (
        dataclasses.replace(
            table,
            tasks=conditions.tasks,
            reward=conditions.reward,
            trial_episodes=entry.trial_episodes,
        )
        for table in tables
    )
    seeds = tuple(contestant.seed for contestant in entry.contestants)
    return Line(entry.name, entry.style, seeds, tuple(named), entry.training_steps)
