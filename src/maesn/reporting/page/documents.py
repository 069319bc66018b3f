"""What the pages say: of runs, and of a study."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maesn.reporting import runs as records
from maesn.reporting import statistics
from maesn.reporting.comparison import Comparison
from maesn.reporting.figures.curves import moving_mean, window_of
from maesn.reporting.page.writing import rounded
from maesn.reporting.runs import RecordedRun, read_recorded
from maesn.reporting.series import Series, compare_runs, group_series, read_runs
from maesn.reporting.study import read_comparisons
from maesn.reporting.style import LineStyle, MethodStyle
from maesn.reporting.tables import summary_tables
from maesn.settings import leaves
from maesn.storage import read_json

Document = dict[str, Any]

_MOST_POINTS = 300  # of a curve: more are not seen
_SHOWN_EPISODES, _SHOWN_POINTS = 50, 40
_METRICS = {
    "return_after": "return after the inner update",
    "return_before": "return before the inner update",
    "success_after": "success after the inner update",
}
_KEPT = ("settings", "learner", "world", "versions", "provenance")  # of what `config.json` says
# Said where something is missing.
_NO_PLANE = "The family does not say where things are in a plane, so no paths can be shown."
_NO_LATENTS = "This method has no latent."
_NO_SEARCH = "There is no prior over returns yet: `maesn prior DIR` makes it, then report again."


def run_page(directories: Sequence[Path]) -> Document:
    """Return the document of the page of one run or several.

    What the latents do is shown of the first run that has recorded it. A `RunError` says which file
    is missing or broken, or why the runs cannot be compared.
    """
    runs = read_runs(directories)
    series = group_series(runs)
    shown = next((run for run in runs if (run.path / records.LATENT_PATHS).exists()), runs[0])
    return {
        "title": f"{' and '.join(one.label for one in series)} on {runs[0].family}",
        "subtitle": ", ".join(run.path.resolve().name for run in runs),
        **_plane(shown),
        "learning": _learning(series),
        "adaptation": [
            {"name": one.tasks, "charts": _adaptation(one)} for one in compare_runs(series)
        ],
        "settings": _settings([run.path.name for run in runs], [*map(_made_from, runs)]),
    }


def study_page(directory: Path) -> Document:
    """Return the document of a study's page; a `RunError` says which file is missing or damaged."""
    manifest, comparisons = read_comparisons(directory)
    return {
        "title": f"Study {manifest['study']}",
        "subtitle": ", ".join(one.name for one in comparisons) or "nothing compared yet",
        "comparisons": [_comparison(one) for one in comparisons],
        "provenance": {
            "columns": ["", "value"],
            "rows": [
                ["command", f"maesn study run {manifest['study']}"],
                *([name, version] for name, version in manifest.get("versions", {}).items()),
                *(["job", job] for job in manifest["jobs"]),
            ],
        },
    }


def _comparison(comparison: Comparison) -> Document:
    """Return charts, tables, the tasks' returns and settings; first those in which lines differ."""
    lines = comparison.lines
    thresholds, profiles = statistics.profiles([line.column(-1) for line in lines])
    above = [
        _curve(line.style, thresholds, *profile.band)
        for line, profile in zip(lines, profiles, strict=True)
    ]
    settings = _settings([line.label for line in lines], [line.settings for line in lines])
    differing = [row for row in settings["rows"] if len(set(row[1:])) > 1]
    settings["rows"].sort(key=lambda row: row not in differing)
    return {
        "name": comparison.name,
        "about": f"{comparison.family}, {comparison.tasks}",
        "charts": [
            *_adaptation(comparison),
            _chart("return τ", "share of tasks that end above τ", above),
        ],
        "tables": [table._asdict() for table in summary_tables(comparison)],
        "scatter": [
            {"label": line.label, "returns": rounded(line.column(-1).mean(axis=0))}
            for line in comparison.everyone
        ],
        "settings": {**settings, "differing": len(differing)},
    }


def _adaptation(comparison: Comparison) -> list[Document]:
    """Return the charts of return and success over the episodes in the new task."""
    first = comparison.lines[0].table
    texts = {"mean_return": f"mean {first.reward} return", "success_rate": "success rate"}
    charts = []
    for measure, text in texts.items():
        curves = [
            _curve(line.style, line.table.episodes, *statistics.curve(line.measure(measure)).band)
            for line in comparison.lines
        ]
        charts.append(_chart("episodes in the new task", text, curves))
    return charts


def _learning(series: Sequence[Series]) -> list[Document]:
    """Return the charts of meta-training; every seed has a line of its own."""
    read = ((one, records.read_learning_curve(run.path)) for one in series for run in one.runs)
    known = [(one.style, vars(found)) for one, found in read if found is not None]
    charts = []
    for metric, text in _METRICS.items():
        curves = []
        for style, found in known:
            x = found["iteration"]
            smooth = moving_mean(found[metric][None], window_of(len(x)))
            curves.append(_curve(style, x, smooth[0]))
        if any(np.isfinite(found[metric]).any() for _, found in known):
            charts.append(_chart("meta-iteration", text, curves))
    return charts


def _chart(x: str, y: str, curves: Sequence[Document]) -> Document:
    return {"title": y, "x": x, "y": y, "lines": list(curves)}


def _curve(style: MethodStyle, x: Any, mean: Any, low: Any = (), high: Any = ()) -> Document:
    """Return a line; with a band between `low` and `high` if they are given."""
    kept = np.unique(np.linspace(0, len(x) - 1, _MOST_POINTS).round().astype(int))
    columns = {"x": x, "mean": mean, "low": low, "high": high}
    numbers = {name: rounded(y[kept]) if len(y) else [] for name, y in columns.items()}
    return {"label": style.label, "colour": style.colour, "dash": dash(style.line), **numbers}


def dash(line: LineStyle) -> str:
    """Return Matplotlib's dash in plotly's words."""
    if isinstance(line, str):
        return {":": "dot", "--": "dash", "-.": "dashdot"}.get(line, "solid")
    return ",".join(f"{3 * length:g}px" for length in line[1])


def _plane(run: RecordedRun) -> Document:
    """Return what is drawn in the plane of the world, or why it cannot be."""
    explored = read_recorded(records.RecordedExploration, run.path / records.EXPLORATION)
    if explored is None:
        missing = {"missing": _NO_PLANE}
        return {"world": None, "explorer": missing, "search": missing, "exploration": missing}
    times = np.linspace(0, explored.prior_paths.shape[1] - 1, _SHOWN_POINTS).round().astype(int)
    panels = {
        "trained, z drawn": explored.prior_paths,
        "trained, z fixed": explored.fixed_paths,
        "untrained": explored.untrained_paths,
    }
    landmarks = explored.landmarks
    return {
        "world": {
            "goals": rounded(explored.goals),
            "radius": explored.sparse_radius,
            "landmarks": None if landmarks is None else rounded(landmarks),
        },
        **_latents(run, len(explored.goals)),
        "exploration": {
            "panels": [
                {"title": title, "paths": rounded(paths[:_SHOWN_EPISODES, times])}
                for title, paths in panels.items()
                if paths is not None
            ]
        },
    }


def _latents(run: RecordedRun, num_goals: int) -> Document:
    """Return the path of each latent, the tasks' adapted latents, and recorded searches."""
    paths = read_recorded(records.LatentPaths, run.path / records.LATENT_PATHS)
    searches = read_recorded(records.RecordedSearches, run.path / records.SEARCHES)
    if paths is None:
        return {"explorer": {"missing": _NO_LATENTS}, "search": {"missing": _NO_LATENTS}}
    explorer = {name: rounded(value) for name, value in vars(paths).items()} | {"adapted": []}
    adapted = run.latents(records.RECORDED_TASKS, "sparse")
    if adapted is not None and len(adapted.mean) == num_goals:
        explorer["adapted"] = rounded(adapted.mean[:, -1])
    if searches is None:
        return {"explorer": explorer, "search": {"missing": _NO_SEARCH}}
    digits = {"mean": 1, "std": 1}
    search = {name: rounded(x, digits.get(name, 3)) for name, x in vars(searches).items()}
    return {"explorer": explorer, "search": search}


def _made_from(run: RecordedRun) -> Document:
    """Return all settings of a run, and what made it."""
    config = read_json(run.path / "config.json")
    return leaves({name: config[name] for name in _KEPT if config.get(name)})


def _settings(heads: Sequence[str], columns: Sequence[Mapping[str, Any]]) -> Document:
    """Return settings by their path, one column for each method or run."""
    names = dict.fromkeys(name for column in columns for name in column)
    found = [[name, *(column.get(name) for column in columns)] for name in names]
    rows = [["" if value is None else str(value) for value in row] for row in found]
    return {"columns": ["setting", *heads], "rows": rows}
