"""Which runs are seeds of one experiment, and what they are compared in."""

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from maesn.reporting.comparison import Comparison, Line
from maesn.reporting.published import comparable_curve
from maesn.reporting.reading import TableName, read_adaptation, stack_seeds
from maesn.reporting.runs import RecordedRun, read_run
from maesn.reporting.style import METHOD_STYLES, MethodStyle, series_styles
from maesn.settings import leaves
from maesn.storage import RunError

# What decides, beside the family, whether returns can be compared at all.
_WORLD = ("variant", "sparse_radius", "engine")
# What two seeds of one experiment may differ in: it changes nothing, or chance alone.
_IMMATERIAL = ("seed", "checkpoint_every", "num_threads")


@dataclass(frozen=True)
class Series:
    """Runs that differ in their seed alone; each figure has one line for them."""

    name: str
    """For file names: the method, numbered if the figure has several series of it."""
    style: MethodStyle
    runs: tuple[RecordedRun, ...]

    @property
    def label(self) -> str:
        """The method's name, with the settings in which it differs from others of that name."""
        return self.style.label


def compare_runs(series: Sequence[Series]) -> list[Comparison]:
    """Return a comparison for each task set and reward that some run was adapted to."""
    found: defaultdict[tuple[str, str], list[Line]] = defaultdict(list)
    for one in series:
        files: defaultdict[TableName, dict[int, Path]] = defaultdict(dict)
        for run in one.runs:
            for name, file in run.tables().items():
                files[name][run.seed] = file
        for name in sorted(files):
            lines = found[name.tasks, name.reward]
            number = sum(line.source == one.name for line in lines)
            lines.append(_line(one, name.changed, number, files[name]))
    family = series[0].runs[0].family
    return [
        Comparison(tuple(lines), name=f"{tasks}-{reward}", family=family)
        for (tasks, reward), lines in found.items()
    ]


def _line(one: Series, changed: str, number: int, files: Mapping[int, Path]) -> Line:
    """Read the tables that one rule has left, by seed; it is the series' line of that number."""
    table, run = stack_seeds([read_adaptation(file) for file in files.values()]), one.runs[0]
    rule = table.rule or changed.strip("-")
    style = one.style.variant(number, f"{one.label} ({rule})" if rule else one.label)
    world = (run.family, run.settings["variant"], run.settings.get("sparse_radius"))
    return Line(
        one.name + changed,
        style,
        tuple(files),
        table,
        source=one.name,
        published=None if changed else comparable_curve(*world, run.method, table),
    )


def read_runs(directories: Sequence[Path]) -> list[RecordedRun]:
    """Read runs for a common figure, each once; a `RunError` says why they cannot have one."""
    distinct: dict[Path, Path] = {}
    for path in directories:
        distinct.setdefault(path.resolve(), path)
    runs = [read_run(path) for path in distinct.values()]
    check_world(runs)
    return runs


def check_world(runs: Sequence[RecordedRun]) -> None:
    """Refuse runs whose returns cannot be compared: each needs figures of its own."""
    for name in ("family", *_WORLD):
        found = {_text(run.settings.get(name)) for run in runs}
        if len(found) > 1:
            raise RunError(
                f"runs in one figure must have the same `{name}`, got "
                f"{' and '.join(sorted(found))}: report on each by itself."
            )


def group_series(runs: Sequence[RecordedRun]) -> list[Series]:
    """Return one series for each experiment, in the order of the methods' styles.

    A `RunError` names runs that have the same settings, the seed included.
    """
    experiments: defaultdict[str, dict[int, RecordedRun]] = defaultdict(dict)
    order = {method: position for position, method in enumerate(METHOD_STYLES)}
    for run in sorted(runs, key=lambda run: order.get(run.method, len(order))):
        seeds = experiments[_text(_experiment(run))]
        if run.seed in seeds:
            raise RunError(
                f"Expected runs with different seeds or settings, got seed {run.seed} in both "
                f"`{seeds[run.seed].path}` and `{run.path}`; give only one of them."
            )
        seeds[run.seed] = run
    groups = [tuple(seeds.values()) for seeds in experiments.values()]
    methods = [runs[0].method for runs in groups]
    series: list[Series] = []
    for method, group, style in zip(methods, groups, series_styles(methods), strict=True):
        number = 1 + sum(one.runs[0].method == method for one in series)
        rivals = [other[0] for other in groups if other[0].method == method]
        name = f"{method}-{number}" if number > 1 else method
        label = style.label + _differences(group[0], rivals)
        series.append(Series(name, replace(style, label=label), group))
    return series


def _experiment(run: RecordedRun) -> dict[str, Any]:
    """Return all settings that decide what is learned, by their path."""
    settings = leaves({**run.settings, "learner": run.learner})
    return {name: value for name, value in settings.items() if name not in _IMMATERIAL}


def _differences(run: RecordedRun, rivals: Sequence[RecordedRun]) -> str:
    """Name the settings in which a run differs from other experiments with its method."""
    own, *others = [_experiment(one) for one in (run, *rivals)]
    changed = [
        f"{name.rpartition('.')[2].replace('_', ' ')} {_text(own.get(name))}"
        for name in sorted({name for other in others for name in other})
        if any(_text(other.get(name)) != _text(own.get(name)) for other in others)
    ]
    return f" ({', '.join(changed)})" if changed else ""


def _text(value: Any) -> str:
    """Write a setting, however nested, so that equal settings give equal texts."""
    return value if isinstance(value, str) else json.dumps(value, sort_keys=True)
