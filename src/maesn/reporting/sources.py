"""Where comparisons come from: runs, and the tables that a study has left."""

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from maesn.reporting import reading
from maesn.reporting import runs as records
from maesn.reporting.comparison import Comparison, Line
from maesn.reporting.published import comparable_curve
from maesn.reporting.runs import LearningCurve, RecordedRun
from maesn.reporting.style import MethodStyle, series_styles
from maesn.settings import leaves
from maesn.storage import RunError, read_json

MANIFEST = "study.json"

# What decides whether returns can be compared at all.
_WORLD = ("family", "variant", "sparse_radius", "engine")
# What two seeds of one experiment may differ in: it changes nothing, or chance alone.
_IMMATERIAL = ("seed", "checkpoint_every", "num_threads")

Document = Mapping[str, Any]


@dataclass(frozen=True)
class Series:
    """Runs that differ in their seed alone; each figure has one line for them."""

    name: str  # the method, numbered from its second series on
    style: MethodStyle
    runs: tuple[RecordedRun, ...]

    def learning_curves(self) -> list[LearningCurve]:
        """Return the metrics of meta-training of those runs that have any."""
        found = (records.read_learning_curve(run.path) for run in self.runs)
        return [curve for curve in found if curve is not None]


def read_series(directories: Sequence[Path]) -> list[Series]:
    """Read runs for a common report; a `RunError` says why they cannot have one."""
    runs = [records.read_run(path) for path in directories]
    for name in _WORLD:
        found = sorted({str(run.settings.get(name)) for run in runs})
        if len(found) > 1:
            raise RunError(
                f"runs in one figure must have the same `{name}`, got {' and '.join(found)}: "
                "report on each by itself."
            )
    return group_series(runs)


def group_series(runs: Sequence[RecordedRun]) -> list[Series]:
    """Return one series for each experiment, in the order of the runs.

    Several with one method are called by the directories of their first runs. A `RunError` names
    runs that have the same settings, the seed included.
    """
    experiments: defaultdict[str, dict[int, RecordedRun]] = defaultdict(dict)
    for run in runs:
        settings = leaves(run.settings).items()
        deciding = {name: value for name, value in settings if name not in _IMMATERIAL}
        seeds = experiments[json.dumps(deciding, sort_keys=True)]
        if run.seed in seeds:
            raise RunError(
                f"Expected runs with different seeds or settings, got seed {run.seed} in both "
                f"`{seeds[run.seed].path}` and `{run.path}`; give only one of them."
            )
        seeds[run.seed] = run
    groups = [tuple(seeds.values()) for seeds in experiments.values()]
    methods = [group[0].method for group in groups]
    series: list[Series] = []
    for method, group, style in zip(methods, groups, series_styles(methods), strict=True):
        number, label = 1 + methods[: len(series)].count(method), style.label
        if methods.count(method) > 1:
            label += f" ({group[0].path.name})"
        name = f"{method}-{number}" if number > 1 else method
        series.append(Series(name, replace(style, label=label), group))
    return series


def compare_runs(series: Sequence[Series]) -> list[Comparison]:
    """Return a comparison for each task set and reward that some run was adapted to."""
    found: defaultdict[tuple[str, str], list[Line]] = defaultdict(list)
    for one in series:
        files: defaultdict[reading.TableName, dict[int, Path]] = defaultdict(dict)
        for run in one.runs:
            for file in (run.path / "adaptation").glob("*.csv"):
                files[reading.table_name(file)][run.seed] = file
        for name in sorted(name for name in files if name.reward):
            lines = found[name.tasks, name.reward]
            number = sum(line.source == one.name for line in lines)
            lines.append(_line_of_runs(one, name, number, files[name]))
    family = series[0].runs[0].family
    return [
        Comparison(tuple(lines), f"{tasks}-{reward}", family)
        for (tasks, reward), lines in found.items()
    ]


def _line_of_runs(
    one: Series, name: reading.TableName, number: int, files: Mapping[int, Path]
) -> Line:
    """Return what one rule has left; it is the series' line of that number, from 0."""
    run, tables = one.runs[0], [reading.read_adaptation(file) for file in files.values()]
    table = reading.stack_seeds(tables)
    rule = " ".join(name.changed.split("-")[1:-1])  # without the digest of its settings
    world = (run.family, run.settings["variant"], run.settings.get("sparse_radius"))
    is_recorded = name[:2] == (records.RECORDED_TASKS, "sparse")
    return Line(
        one.name + name.changed,
        one.style.variant(number, f"{one.style.label} ({rule})" if rule else one.style.label),
        tuple(files),
        table,
        source=one.name,
        published=None if rule else comparable_curve(*world, run.method, table),
        recorded=run.path / records.EXPLORATION if is_recorded else None,
        latents=reading.latents_beside(next(iter(files.values()))),
    )


def studies_in(directory: Path) -> list[Path]:
    """Return the directory of a study, or those of all in it."""
    found = (*directory.glob(MANIFEST), *directory.glob(f"*/{MANIFEST}"))
    return sorted(path.parent for path in found)


def joined_files(directory: Path) -> dict[str, list[str]]:
    """Return which files a study's directory has, and the jobs whose results each joins."""
    path = directory / MANIFEST
    files = read_json(path).get("files", {}) if path.exists() else {}
    return {name: jobs for name, jobs in files.items() if (directory / name).exists()}


def compare_study(directory: Path) -> tuple[Document, list[Comparison]]:
    """Read a study's manifest, and its comparisons; a `RunError` says which file is damaged."""
    document = read_json(directory / MANIFEST, "run the study again")
    try:
        worlds = [one for one in document["comparisons"] if one["lines"] and one["baselines"]]
        return document, [_comparison(world, directory) for world in worlds]
    except (KeyError, TypeError) as error:
        raise RunError(
            f"`{directory / MANIFEST}` is not what a study writes ({error!r}): run the study again."
        ) from error


def _comparison(world: Document, directory: Path) -> Comparison:
    """Read the tables of a comparison; lines of one source have one colour and other dashes."""
    methods = {line["source"]: line["method"] for line in world["lines"]}
    styles = dict(zip(methods, series_styles([*methods.values()]), strict=True))
    lines: list[Line] = []
    for line in world["lines"]:
        number = sum(one.source == line["source"] for one in lines)
        style = styles[line["source"]].variant(number, line["label"])
        lines.append(_line_of_study(line, style, world, directory))
    baselines, oracle = (
        tuple(_line_of_study(x, MethodStyle(x["label"]), world, directory) for x in world[group])
        for group in ("baselines", "oracle")
    )
    return Comparison(
        lines=tuple(lines),
        baselines=baselines,
        oracle=oracle,
        **{name: world[name] for name in ("name", "family", "sparse_radius", "horizon")},
    )


def _line_of_study(line: Document, style: MethodStyle, world: Document, directory: Path) -> Line:
    files = [directory / seed["table"] for seed in line["seeds"]]
    steps = [seed["training_steps"] for seed in line["seeds"]]
    about = (world["family"], world["variant"], world["sparse_radius"], line["method"])
    # What was published of a method stands beside its first run by its own rule, and no variant.
    same = [one["source"] for one in world["lines"] if one["method"] == line["method"]]
    shown = line["source"] in same[:1] and not (line["addition"] or line["evaluation"]["rule"])
    table = replace(
        reading.stack_seeds([reading.read_adaptation(file) for file in files]),
        tasks=world["tasks"],
        reward=world["reward"],
        trial_episodes=line["trial_episodes"],
    )
    recorded = world["recorded"].get(line["source"])
    evaluation = {f"evaluation.{name}": value for name, value in line["evaluation"].items()}
    return Line(
        line["name"],
        style,
        tuple(seed["seed"] for seed in line["seeds"]),
        table,
        source=line["source"],
        training_steps=max((count for count in steps if count is not None), default=None),
        settings={**evaluation, **line["settings"]},
        published=comparable_curve(*about, table) if shown else None,
        recorded=directory / recorded if recorded else None,
        latents=reading.latents_beside(files[0]),
    )
