"""Where comparisons come from: the files of a study, or runs, which are a study in memory."""

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from maesn.reporting import reading
from maesn.reporting import runs as records
from maesn.reporting.comparison import Comparison, Line
from maesn.reporting.published import comparable_curve
from maesn.reporting.runs import LearningCurve, RecordedRun
from maesn.reporting.style import MethodStyle, series_styles
from maesn.settings import leaves
from maesn.storage import RunError, read_json

MANIFEST = "study.json"
RUN_FIGURES = ("curves", "tasks", "exploration", "noise", "latents")

# Returns can be compared only if these are the same.
_WORLD = ("family", "variant", "sparse_radius", "engine")
# Two seeds of one experiment may differ in these: they change nothing, or chance alone.
_IMMATERIAL = ("seed", "checkpoint_every", "num_threads")

# What a study calls the entries of a table's record.
_EVALUATION = {
    "episodes": "episodes",
    "per_update": "episodes_per_update",
    "deploy": "deploy_episodes",
    "num_tasks": "num_tasks",
    "seed": "seed",
}

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


class Compared(NamedTuple):
    """Everything that a report shows."""

    document: Document
    """The study, as `study.json` describes it."""
    comparisons: list[Comparison]
    series: Sequence[Series] = ()
    """The runs that make up a study in memory; none for a study in files."""


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


def compare_runs(directories: Sequence[Path]) -> Compared:
    """Make a study of runs: one comparison for each task set and reward that one was adapted to.

    A `RunError` says which file is broken, or why the runs cannot be compared.
    """
    series = read_series(directories)
    worlds: dict[str, dict[str, Any]] = {}
    for one in series:
        for name, line, record in _adaptations(one):
            run, world = one.runs[0], record.get("world", {})
            compared = worlds.setdefault(
                f"{name.tasks}-{name.reward}",
                {
                    "name": f"{name.tasks}-{name.reward}",
                    "family": run.family,
                    "variant": run.settings["variant"],
                    "tasks": name.tasks,
                    "reward": name.reward,
                    "sparse_radius": world.get("sparse_radius", run.settings.get("sparse_radius")),
                    "horizon": world.get("horizon", 0),
                    "lines": [],
                    "baselines": [],
                    "oracle": [],
                    "recorded": {},
                },
            )
            compared["lines"].append(line)
            if (name.tasks, name.reward) == (records.RECORDED_TASKS, "sparse"):
                compared["recorded"][one.name] = run.path / records.EXPLORATION
    figures = [{"name": kind, "kind": kind, "lines": [], "families": []} for kind in RUN_FIGURES]
    document = {"comparisons": [*worlds.values()], "figures": figures}
    styles = {one.name: one.style for one in series}
    found = [_comparison(world, Path(), styles) for world in worlds.values()]
    return Compared(document, found, series)


def _adaptations(one: Series) -> Iterator[tuple[reading.TableName, Document, Document]]:
    """Yield each adaptation of runs: its name, its line in a study, and the first run's record."""
    files: defaultdict[reading.TableName, list[tuple[int, Path]]] = defaultdict(list)
    for run in one.runs:
        for name, path in reading.tables_of(run.path).items():
            files[name].append((run.seed, path))
    for name in sorted(files):
        record = reading.read_about(files[name][0][1])
        told = {"rule": name.rule, **{key: record.get(of) for key, of in _EVALUATION.items()}}
        line = {
            "name": one.name + name.rule + name.budget,
            "source": one.name,
            "method": one.runs[0].method,
            "label": f"{one.style.label} ({name.label})" if name.label else one.style.label,
            "addition": False,
            "settings": leaves(one.runs[0].settings),
            "evaluation": told,
            "trial_episodes": record.get("trial_episodes"),
            "seeds": [
                {"seed": seed, "table": path, "training_steps": None} for seed, path in files[name]
            ],
        }
        yield name, line, record


def studies_in(directory: Path) -> list[Path]:
    """Return the directory of a study, or those of all in it."""
    found = (*directory.glob(MANIFEST), *directory.glob(f"*/{MANIFEST}"))
    return sorted(path.parent for path in found)


def joined_files(directory: Path) -> dict[str, list[str]]:
    """Return which files a study's directory has, and the jobs whose results each joins."""
    path = directory / MANIFEST
    files = read_json(path).get("files", {}) if path.exists() else {}
    return {name: jobs for name, jobs in files.items() if (directory / name).exists()}


def compare_study(directory: Path) -> Compared:
    """Read a study's manifest, and its comparisons; a `RunError` says which file is damaged."""
    document = read_json(directory / MANIFEST, "run the study again")
    try:
        worlds = [one for one in document["comparisons"] if one["lines"] and one["baselines"]]
        return Compared(document, [_comparison(world, directory) for world in worlds])
    except (KeyError, TypeError) as error:
        raise RunError(
            f"`{directory / MANIFEST}` is not what a study writes ({error!r}): run the study again."
        ) from error


def _comparison(
    world: Document, directory: Path, styles: Mapping[str, MethodStyle] | None = None
) -> Comparison:
    """Read the tables of a comparison; lines of one source have one colour and other dashes."""
    if styles is None:
        methods = {line["source"]: line["method"] for line in world["lines"]}
        styles = dict(zip(methods, series_styles([*methods.values()]), strict=True))
    lines: list[Line] = []
    for line in world["lines"]:
        number = sum(one.source == line["source"] for one in lines)
        style = styles[line["source"]].variant(number, line["label"])
        lines.append(_line(line, style, world, directory))
    baselines, oracle = (
        tuple(_line(one, MethodStyle(one["label"]), world, directory) for one in world[group])
        for group in ("baselines", "oracle")
    )
    return Comparison(
        lines=tuple(lines),
        baselines=baselines,
        oracle=oracle,
        **{name: world[name] for name in ("name", "family", "sparse_radius", "horizon")},
    )


def _line(line: Document, style: MethodStyle, world: Document, directory: Path) -> Line:
    files = tuple(directory / seed["table"] for seed in line["seeds"])
    steps = [seed["training_steps"] for seed in line["seeds"]]
    about = (world["family"], world["variant"], world["sparse_radius"], line["method"])
    # A published curve stands beside its method's first run by its own rule, and no variant.
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
        files=files,
    )
