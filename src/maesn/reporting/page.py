"""The report page: one HTML file that shows runs or a study, and needs no network."""

import json
import logging
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from maesn.reporting import runs as records
from maesn.reporting import statistics
from maesn.reporting.comparison import Comparison
from maesn.reporting.figures.curves import moving_mean, window_of
from maesn.reporting.reading import TableName, latents_beside
from maesn.reporting.runs import RecordedRun, read_recorded
from maesn.reporting.sources import Series, compare_runs, compare_study, read_series
from maesn.reporting.style import LineStyle, MethodStyle
from maesn.reporting.tables import summary_tables
from maesn.settings import leaves
from maesn.storage import read_json, write_whole

logger = logging.getLogger(__name__)

Document = dict[str, Any]

PAGE = "report.html"

_SHOWN_EPISODES, _SHOWN_POINTS = 50, 40


def write_page(path: Path, document: Document) -> list[Path]:
    """Write a document of `run_page` or `study_page` as one HTML file, and return what was written.

    Without plotly that is nothing, and a warning says so.
    """
    own, text = files("maesn.reporting"), json.dumps(document, allow_nan=False)
    try:
        plotly = files("plotly") / "package_data" / "plotly.min.js"
    except ModuleNotFoundError:
        logger.warning("no page is written: plotly is missing. pip install -e '.[page]'.")
        return []
    page = own.joinpath("page.html").read_text("utf-8")
    for name, content in {
        "style": own.joinpath("page.css").read_text("utf-8"),
        "plotly": plotly.read_text("utf-8"),
        "data": text.replace("<", "\\u003c"),  # no text can end the element, or begin a comment
        "program": own.joinpath("page.js").read_text("utf-8"),
    }.items():
        page = page.replace(f"<!-- {name} -->", content, 1)
    write_whole(path, page.encode())
    return [path]


def run_page(directories: Sequence[Path]) -> Document:
    """Return the document of the page of one run or several.

    What the latents do is shown of the first run that has recorded it. A `RunError` says which file
    is missing or broken, or why the runs cannot be compared.
    """
    series = read_series(directories)
    runs = [run for one in series for run in one.runs]
    shown = next((run for run in runs if (run.path / records.LATENT_PATHS).exists()), runs[0])
    names = [run.path.resolve().name for run in runs]
    return {
        "title": f"{' and '.join(one.style.label for one in series)} on {shown.family}",
        "subtitle": ", ".join(names),
        **_plane(shown),
        "learning": _learning(series),
        "adaptation": [
            {"name": one.tasks, "charts": _adaptation(one)} for one in compare_runs(series)
        ],
        "settings": _settings(names, [leaves(read_json(run.path / "config.json")) for run in runs]),
    }


def study_page(directory: Path) -> Document:
    """Return the document of a study's page; a `RunError` says which file is missing or damaged."""
    study, comparisons = compare_study(directory)
    return {
        "title": f"Study {study['study']}",
        "subtitle": ", ".join(one.name for one in comparisons) or "nothing compared yet",
        "comparisons": [_comparison(one) for one in comparisons],
        "provenance": [
            *map(list, study["versions"].items()),
            *(["job", job] for job in study["jobs"]),
        ],
    }


def _comparison(comparison: Comparison) -> Document:
    """Return charts, tables, the tasks' returns and settings."""
    lines = comparison.lines
    thresholds, profiles = statistics.profiles([line.column(-1) for line in lines])
    pairs = zip(lines, profiles, strict=True)
    above = [_curve(line.style, thresholds, *profile.band) for line, profile in pairs]
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
        "settings": _settings([line.label for line in lines], [line.settings for line in lines]),
    }


def _adaptation(comparison: Comparison) -> list[Document]:
    """Return the charts of return and success over the episodes in the new task."""
    reward, charts = comparison.lines[0].table.reward, []
    for measure, y in {
        "mean_return": f"mean {reward} return",
        "success_rate": "success rate",
    }.items():
        found = ((line, statistics.curve(line.measure(measure)).band) for line in comparison.lines)
        curves = [_curve(line.style, line.table.episodes, *band) for line, band in found]
        charts.append(_chart("episodes in the new task", y, curves))
    return charts


def _learning(series: Sequence[Series]) -> list[Document]:
    """Return the charts of meta-training; every seed has a line of its own."""
    found = [(one.style, vars(curve)) for one in series for curve in one.learning_curves()]
    charts = []
    for metric in ("return_after", "return_before", "success_after"):
        known = [(style, one["iteration"], one[metric]) for style, one in found]
        lines = [
            _curve(style, x, moving_mean(y[None], window_of(len(x)))[0])
            for style, x, y in known
            if np.isfinite(y).any()
        ]
        text = f"{metric.replace('_', ' ')} the inner update"
        charts += [_chart("meta-iteration", text, lines)] if lines else []
    return charts


def _chart(x: str, y: str, curves: Sequence[Document]) -> Document:
    return {"title": y, "x": x, "y": y, "lines": curves}


def _curve(style: MethodStyle, x: Any, mean: Any, low: Any = (), high: Any = ()) -> Document:
    """Return a line; with a band between `low` and `high` if they are given."""
    columns = {"x": x, "mean": mean, "low": low, "high": high}
    look = {"label": style.label, "colour": style.colour, "dash": _dash(style.line)}
    return look | {name: rounded(column) for name, column in columns.items()}


def _dash(line: LineStyle) -> str:
    """Return Matplotlib's dash in plotly's words."""
    if isinstance(line, str):
        return {":": "dot", "--": "dash", "-.": "dashdot"}.get(line, "solid")
    return ",".join(f"{3 * length:g}px" for length in line[1])


def _plane(run: RecordedRun) -> Document:
    """Return what is drawn in the plane of the world; None for what was not recorded."""
    explored = read_recorded(records.RecordedExploration, run.path / records.EXPLORATION)
    if explored is None:
        return dict.fromkeys(("world", "explorer", "search", "exploration"))
    times = np.linspace(0, explored.prior_paths.shape[1] - 1, _SHOWN_POINTS).round().astype(int)
    panels = {
        "trained, z drawn": explored.prior_paths,
        "trained, z fixed": explored.fixed_paths,
        "untrained": explored.untrained_paths,
    }
    shown = [
        {"title": title, "paths": rounded(paths[:_SHOWN_EPISODES, times])}
        for title, paths in panels.items()
        if paths is not None
    ]
    goals, landmarks = rounded(explored.goals), rounded(explored.landmarks)
    table = TableName(records.RECORDED_TASKS, "sparse").path(run.path)
    adapted = read_recorded(records.Latents, latents_beside(table))
    ends = [] if adapted is None else rounded(adapted.mean[:, -1])
    paths = read_recorded(records.LatentPaths, run.path / records.LATENT_PATHS)
    searches = read_recorded(records.RecordedSearches, run.path / records.SEARCHES)
    return {
        "world": {"goals": goals, "radius": explored.sparse_radius, "landmarks": landmarks},
        "explorer": paths and {"adapted": ends, **_numbers(paths)},
        "search": searches and _numbers(searches),
        "exploration": {"panels": shown},
    }


def _numbers(record: Any) -> Document:
    return {name: rounded(values) for name, values in vars(record).items()}


def _settings(heads: Sequence[str], columns: Sequence[Mapping[str, Any]]) -> Document:
    """Return settings by their path, one column for each method or run."""
    names = dict.fromkeys(name for column in columns for name in column)
    found = [[name, *(column.get(name) for column in columns)] for name in names]
    rows = [["" if value is None else str(value) for value in row] for row in found]
    return {"columns": ["setting", *heads], "rows": rows}


def rounded(values: Any) -> Any:
    """Return an array as nested lists of short numbers; None for NaN and for None."""
    numbers = np.asarray(values, np.float64).round(3)
    return np.where(np.isfinite(numbers), numbers.astype(object), np.array(None)).tolist()
