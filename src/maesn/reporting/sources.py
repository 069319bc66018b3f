"""Sources of comparisons: the files of a study, or runs, which are a study in memory."""

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from maesn.reporting import reading
from maesn.reporting import runs as records
from maesn.reporting.comparison import Comparison, Line
from maesn.reporting.published import comparable_curve
from maesn.reporting.reading import TableName
from maesn.reporting.runs import LearningCurve, RecordedRun
from maesn.reporting.style import MethodStyle, series_styles
from maesn.settings import leaves
from maesn.storage import RunError, read_json

MANIFEST = "study.json"
RUN_FIGURES = ("curves", "tasks", "exploration", "noise", "latents")

# Returns can be compared only if these are the same.
_WORLD = ("family", "variant", "sparse_radius")
# Two seeds of one experiment may differ in these: they change nothing, or chance alone.
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


class Compared(NamedTuple):
    """Everything that a report shows: a study in files, or one in memory of runs."""

    comparisons: list[Comparison]
    figures: Sequence[Document]  # as the file of a study describes them
    study: Document  # `study.json`; empty for runs
    series: Sequence[Series]  # runs; none for a study


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
    """Compare runs in each task set and on each reward that some run was adapted to.

    A `RunError` says which file is broken, or why the runs cannot be compared.
    """
    series, found = read_series(directories), defaultdict[str, list[Line]](list)
    for one in series:
        files: defaultdict[TableName, dict[int, Path]] = defaultdict(dict)
        for run in one.runs:
            for name, table in reading.tables_of(run.path).items():
                files[name][run.seed] = table
        for name in sorted(files):
            lines = found[f"{name.tasks}-{name.reward}"]
            lines.append(_line_of_runs(one, name, files[name], lines))
    family = series[0].runs[0].family
    comparisons = []
    for title, lines in found.items():
        _check_tasks(title, lines)
        world = lines[0].table.about.get("world", {})
        horizon = world.get("horizon", 0)
        comparisons.append(Comparison(tuple(lines), title, family, horizon=horizon))
    figures = [{"name": kind, "kind": kind} for kind in RUN_FIGURES]
    return Compared(comparisons, figures, {}, series)


def _check_tasks(title: str, lines: Sequence[Line]) -> None:
    """Refuse tables that are known to be of different tasks, although these have one name."""
    known = dict[str, Path]()
    for table in (file for line in lines for file in line.files):
        record = table.with_suffix(reading.RECORD)
        if record.exists() and (digest := read_json(record).get("task_digest")):
            known.setdefault(digest, table)
    if len(known) > 1:
        first, second, *_ = known.values()
        remedy = "the family has changed since one was written, so adapt again"
        if title.startswith("training"):
            remedy = (
                "`training` is what each run was trained on, so move one of the files elsewhere"
            )
        raise RunError(f"`{first}` and `{second}` are of different tasks: {remedy}.")


def _line_of_runs(
    one: Series, name: TableName, files: Mapping[int, Path], others: Sequence[Line]
) -> Line:
    """Return the adaptations of that name; `others` are the lines before it in the comparison."""
    run, tables = one.runs[0], [reading.read_adaptation(file) for file in files.values()]
    table = reading.stack_seeds(tables)
    number = sum(line.source == one.name for line in others)
    label = f"{one.style.label} ({name.label})" if name.label else one.style.label
    world = (run.family, run.settings["variant"], run.settings.get("sparse_radius"))
    is_recorded = (name.tasks, name.reward) == (records.RECORDED_TASKS, "sparse")
    return Line(
        one.name + name.rule + name.budget,
        one.style.variant(number, label),
        tuple(files),
        table,
        source=one.name,
        weights=tuple(table.about.get("weights") for table in tables),
        settings=leaves({"evaluation": table.about, **run.settings}),
        published=None if name.rule else comparable_curve(*world, run.method, table),
        recorded=run.path / records.EXPLORATION if is_recorded else None,
        files=tuple(files.values()),
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


def compare_study(directory: Path) -> Compared:
    """Read a study's manifest, and its comparisons; a `RunError` says which file is damaged."""
    study = read_json(directory / MANIFEST, "run the study again")
    try:
        worlds = [one for one in study["comparisons"] if one["lines"] and one["baselines"]]
        comparisons = [_comparison(world, directory) for world in worlds]
        return Compared(comparisons, study["figures"], study, ())
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
    about = {name: world[name] for name in ("name", "family", "sparse_radius", "horizon")}
    return Comparison(tuple(lines), baselines=baselines, oracle=oracle, **about)


def _line_of_study(line: Document, style: MethodStyle, world: Document, directory: Path) -> Line:
    files = tuple(directory / seed["table"] for seed in line["seeds"])
    steps = [seed["training_steps"] for seed in line["seeds"]]
    about = (world["family"], world["variant"], world["sparse_radius"], line["method"])
    # A published curve stands beside its method's first run by its own rule, and no variant.
    same = [one["source"] for one in world["lines"] if one["method"] == line["method"]]
    shown = line["source"] in same[:1] and not (line["addition"] or line["evaluation"]["rule"])
    told, asked = {name: world[name] for name in ("tasks", "reward")}, line["evaluation"]
    record = {"trial_episodes": line["trial_episodes"], "trained_on": asked.get("trained_on")}
    record |= {"episodes_per_update": asked["per_update"], "deploy_episodes": asked["deploy"]}
    tables = [reading.read_adaptation(file, record) for file in files]
    table = replace(reading.stack_seeds(tables), **told)
    recorded = world["recorded"].get(line["source"])
    return Line(
        line["name"],
        style,
        tuple(seed["seed"] for seed in line["seeds"]),
        table,
        source=line["source"],
        training_steps=max((count for count in steps if count is not None), default=None),
        settings=leaves({"evaluation": line["evaluation"], **line["settings"]}),
        published=comparable_curve(*about, table) if shown else None,
        recorded=directory / recorded if recorded else None,
        files=files,
    )
