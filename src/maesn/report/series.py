"""Which runs are seeds of one experiment, and which experiments belong in one figure."""

import json
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from maesn.report.adaptation_table import Line
from maesn.report.runs import RecordedRun
from maesn.report.style import METHOD_STYLES, MethodStyle, series_styles
from maesn.storage import RunError

# What decides whether returns can be compared at all.
_WORLD = ("family", "variant", "sparse_radius", "engine")
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

    def adapted(self, tasks: str, reward: str) -> Line | None:
        """Return the adaptation of those runs that have one; None if none has."""
        tables = {run.seed: run.adaptation(tasks, reward) for run in self.runs}
        found = {seed: table for seed, table in tables.items() if table is not None}
        return Line(self.name, self.style, (*found,), (*found.values(),)) if found else None


def group_worlds(runs: Sequence[RecordedRun]) -> dict[str, list[RecordedRun]]:
    """Return the runs of each world, in the order given, by a name for a directory.

    A world is a family, its variant, the sparse radius and the engine. The name has the family, and
    the others where they are needed to tell two worlds apart.
    """
    worlds: defaultdict[tuple[str, ...], list[RecordedRun]] = defaultdict(list)
    for run in runs:
        worlds[tuple(_text(run.settings.get(name)) for name in _WORLD)].append(run)
    named: dict[str, list[RecordedRun]] = {}
    for world, members in worlds.items():
        others = [other for other in worlds if other[0] == world[0]]
        parts = [world[0]]
        for position, prefix in ((1, ""), (2, "radius-"), (3, "")):
            if any(other[position] != world[position] for other in others):
                parts.append(prefix + world[position])
        named[re.sub(r"[^\w.]+", "-", "-".join(parts))] = members
    return named


def group_series(runs: Sequence[RecordedRun]) -> list[Series]:
    """Return one series for each experiment, in the order of the methods' styles.

    Raises:
        RunError: if two runs have the same settings, the seed included.
    """
    experiments: defaultdict[str, list[RecordedRun]] = defaultdict(list)
    order = {method: position for position, method in enumerate(METHOD_STYLES)}
    for run in sorted(runs, key=lambda run: order.get(run.method, len(order))):
        experiments[_text(_experiment(run))].append(run)
    for members in experiments.values():
        _check_seeds_differ(members)
    firsts = [members[0] for members in experiments.values()]
    methods = [run.method for run in firsts]
    series = []
    for position, (style, members) in enumerate(
        zip(series_styles(methods), experiments.values(), strict=True)
    ):
        method, before = methods[position], methods[:position].count(methods[position])
        name = f"{method}-{before + 1}" if before else method
        label = style.label + _differences(members[0], firsts)
        series.append(Series(name, replace(style, label=label), tuple(members)))
    return series


def _experiment(run: RecordedRun) -> dict[str, Any]:
    """Return all settings that decide what is learned, by their path."""
    settings = {name: value for name, value in run.settings.items() if name not in _IMMATERIAL}
    return {**settings, **dict(_leaves("learner", run.learner))}


def _leaves(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for name, child in value.items():
            yield from _leaves(f"{path}.{name}", child)
    else:
        yield path, value


def _check_seeds_differ(runs: Sequence[RecordedRun]) -> None:
    seen: dict[int, RecordedRun] = {}
    for run in runs:
        if run.seed in seen:
            raise RunError(
                f"Expected runs with different seeds or settings, got seed {run.seed} in both "
                f"`{seen[run.seed].path}` and `{run.path}`; give only one of them."
            )
        seen[run.seed] = run


def _differences(run: RecordedRun, firsts: Sequence[RecordedRun]) -> str:
    """Name the settings in which a run differs from other experiments with its method."""
    rivals = [_experiment(other) for other in firsts if other.method == run.method]
    own = _experiment(run)
    changed = [
        f"{name.rpartition('.')[2].replace('_', ' ')} {_text(own.get(name))}"
        for name in sorted({name for rival in rivals for name in rival})
        if any(_text(rival.get(name)) != _text(own.get(name)) for rival in rivals)
    ]
    return f" ({', '.join(changed)})" if changed else ""


def _text(value: Any) -> str:
    """Write a setting, however nested, so that equal settings give equal texts."""
    return value if isinstance(value, str) else json.dumps(value, sort_keys=True)
