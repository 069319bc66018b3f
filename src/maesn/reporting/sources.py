"""Where comparisons come from: runs, and the tables that a study has left."""

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from maesn.reporting.comparison import Comparison, Line
from maesn.reporting.published import comparable_curve
from maesn.reporting.reading import (
    TableName,
    latents_beside,
    read_adaptation,
    stack_seeds,
    table_name,
)
from maesn.reporting.runs import (
    EXPLORATION,
    RECORDED_TASKS,
    LearningCurve,
    RecordedRun,
    read_learning_curve,
    read_run,
)
from maesn.reporting.style import METHOD_STYLES, MethodStyle, series_styles
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

    name: str
    """The method, numbered if there are several series of it."""
    style: MethodStyle
    runs: tuple[RecordedRun, ...]

    @property
    def label(self) -> str:
        """How figures and tables call it."""
        return self.style.label

    def learning_curves(self) -> list[LearningCurve]:
        """Return the metrics of meta-training of those runs that have any."""
        found = (read_learning_curve(run.path) for run in self.runs)
        return [curve for curve in found if curve is not None]


def read_series(directories: Sequence[Path]) -> list[Series]:
    """Read runs for a common report; a `RunError` says why they cannot have one."""
    runs = [read_run(path) for path in directories]
    for name in _WORLD:
        found = sorted({str(run.settings.get(name)) for run in runs})
        if len(found) > 1:
            raise RunError(
                f"runs in one figure must have the same `{name}`, got {' and '.join(found)}: "
                "report on each by itself."
            )
    return group_series(runs)


def group_series(runs: Sequence[RecordedRun]) -> list[Series]:
    """Return one series for each experiment, in the order of the methods' styles.

    Several with one method are called by the directories of their first runs. A `RunError` names
    runs that have the same settings, the seed included.
    """
    experiments: defaultdict[str, dict[int, RecordedRun]] = defaultdict(dict)
    order = {method: position for position, method in enumerate(METHOD_STYLES)}
    for run in sorted(runs, key=lambda run: order.get(run.method, len(order))):
        settings = leaves({**run.settings, "learner": run.learner}).items()
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
    series = []
    for position, style in enumerate(series_styles(methods)):
        method, group, label = methods[position], groups[position], style.label
        earlier = methods[:position].count(method)
        name = f"{method}-{earlier + 1}" if earlier else method
        if methods.count(method) > 1:
            label += f" ({group[0].path.name})"
        series.append(Series(name, replace(style, label=label), group))
    return series


def compare_runs(series: Sequence[Series]) -> list[Comparison]:
    """Return a comparison for each task set and reward that some run was adapted to."""
    found: defaultdict[tuple[str, str], list[Line]] = defaultdict(list)
    for one in series:
        files: defaultdict[TableName, dict[int, Path]] = defaultdict(dict)
        for run in one.runs:
            for file in (run.path / "adaptation").glob("*.csv"):
                files[table_name(file)][run.seed] = file
        first = one.runs[0]
        world = (first.family, first.settings["variant"], first.settings.get("sparse_radius"))
        for name in sorted(name for name in files if name.reward):
            lines, rule = found[name.tasks, name.reward], name.changed.replace("-", " ").strip()
            label = f"{one.label} ({rule})" if rule else one.label
            style = one.style.variant(sum(line.source == one.name for line in lines), label)
            about = (*world, "" if rule else first.method)
            lines.append(_line(one.name + name.changed, one.name, style, files[name], about))
    records = {one.name: one.runs[0].path / EXPLORATION for one in series}
    recorded = {name: path for name, path in records.items() if path.exists()}
    return [
        Comparison(
            tuple(lines),
            name=f"{tasks}-{reward}",
            family=series[0].runs[0].family,
            recorded=recorded if (tasks, reward) == (RECORDED_TASKS, "sparse") else {},
        )
        for (tasks, reward), lines in found.items()
    ]


def studies_in(directory: Path) -> list[Path]:
    """Return the directory of a study, or those of all in it."""
    if (directory / MANIFEST).exists():
        return [directory]
    return [path.parent for path in sorted(directory.glob(f"*/{MANIFEST}"))]


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
        recorded={name: directory / file for name, file in world["recorded"].items()},
        **{name: world[name] for name in ("name", "family", "sparse_radius", "horizon")},
    )


def _line_of_study(line: Document, style: MethodStyle, world: Document, directory: Path) -> Line:
    files = {seed["seed"]: directory / seed["table"] for seed in line["seeds"]}
    method = "" if line["addition"] else line["method"]
    about = (world["family"], world["variant"], world["sparse_radius"], method)
    told = {"trial_episodes": line["trial_episodes"]}
    told |= {name: world[name] for name in ("tasks", "reward")}
    steps = [seed["training_steps"] for seed in line["seeds"]]
    evaluation = {f"evaluation.{name}": value for name, value in line["evaluation"].items()}
    return replace(
        _line(line["name"], line["source"], style, files, about, **told),
        training_steps=max((count for count in steps if count is not None), default=None),
        settings={**evaluation, **line["settings"]},
    )


def _line(
    name: str,
    source: str,
    style: MethodStyle,
    files: Mapping[int, Path],
    about: Sequence[Any],
    **told: Any,
) -> Line:
    """Read a method's tables by their seeds; `told` is what the tables' names do not say.

    `about` chooses the published curve: family, variant, sparse radius and method.
    """
    table = replace(stack_seeds([read_adaptation(file) for file in files.values()]), **told)
    family, variant, radius, method = about
    latents = latents_beside(next(iter(files.values())))
    return Line(
        name,
        style,
        tuple(files),
        table,
        source,
        published=comparable_curve(family, variant, radius, method, table),
        latents=latents if latents.exists() else None,
    )
