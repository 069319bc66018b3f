"""Which runs are seeds of one experiment, and which experiments belong in one figure."""

import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from maesn.reporting.adaptation_table import AdaptationTable, Line
from maesn.reporting.reading import read_adaptation
from maesn.reporting.runs import RecordedRun
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

    def adapted(self, tasks: str, reward: str) -> list[Line]:
        """Return a line for each rule by which runs were adapted to a task set."""
        found: defaultdict[str, dict[int, AdaptationTable]] = defaultdict(dict)
        for run in self.runs:
            for name, file in run.tables().items():
                if (name.tasks, name.reward) == (tasks, reward):
                    found[name.changed][run.seed] = read_adaptation(file)
        lines: list[Line] = []
        for changed, tables in sorted(found.items()):
            rule = next(iter(tables.values())).rule or changed.strip("-")
            style = self.style.with_rule(len(lines), rule)
            lines.append(Line(self.name + changed, style, (*tables,), (*tables.values(),)))
        return lines


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
    methods = [members[0].method for members in groups]
    series = []
    for position, (members, style) in enumerate(zip(groups, series_styles(methods), strict=True)):
        method, before = methods[position], methods[:position].count(methods[position])
        name = f"{method}-{before + 1}" if before else method
        rivals = [other[0] for other in groups if other[0].method == method]
        label = style.label + _differences(members[0], rivals)
        series.append(Series(name, replace(style, label=label), members))
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
