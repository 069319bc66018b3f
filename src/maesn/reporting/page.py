"""The report page: one HTML file that shows runs or a study, and needs no network."""

import json
import logging
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from maesn.reporting import runs as records
from maesn.reporting.charts import Chart, Curve, adaptation_charts, learning_charts, profile_chart
from maesn.reporting.comparison import Comparison
from maesn.reporting.reading import latents_beside, usual_table
from maesn.reporting.runs import RecordedRun, read_recorded
from maesn.reporting.sources import Compared, Series
from maesn.reporting.style import LineStyle
from maesn.reporting.tables import summary_tables
from maesn.settings import leaves
from maesn.storage import read_json, write_whole

logger = logging.getLogger(__name__)

Document = dict[str, Any]

PAGE = "report.html"

_SHOWN_EPISODES, _SHOWN_POINTS = 50, 40


def write_page(path: Path, document: Document) -> list[Path]:
    """Write a document of `page_of` as one HTML file, and return what was written.

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


def page_of(study: Compared) -> Document:
    """Return the document of the page of a study, or of one or several runs.

    The latents and paths of runs are those of the first run that has recorded them. A `RunError`
    says which file is missing or broken.
    """
    document = {"comparisons": [_comparison(one, study.series) for one in study.comparisons]}
    if study.series:
        return document | _of_runs(study.series)
    names = ", ".join(one.name for one in study.comparisons) or "nothing compared yet"
    rows = [*map(list, study.study["versions"].items())]
    rows += [["job", job] for job in study.study["jobs"]]
    provenance = {"columns": ["", "value"], "rows": rows}
    title = f"Study {study.study['study']}"
    return document | {"title": title, "subtitle": names, "provenance": provenance}


def _of_runs(series: Sequence[Series]) -> Document:
    runs = [run for one in series for run in one.runs]
    shown = next((run for run in runs if (run.path / records.LATENT_PATHS).exists()), runs[0])
    names = [run.path.resolve().name for run in runs]
    learning = [_chart(one) for charts in learning_charts(series).values() for one in charts]
    return {
        "title": f"{' and '.join(one.style.label for one in series)} on {shown.family}",
        "subtitle": ", ".join(names),
        "plane": _plane(shown),
        "learning": [chart for chart in learning if chart["lines"]],
        "provenance": _settings(names, [leaves(read_json(x.path / "config.json")) for x in runs]),
    }


def _comparison(comparison: Comparison, series: Sequence[Series]) -> Document:
    """Return charts, tables, the tasks' returns and settings."""
    lines, about = comparison.lines, f"{comparison.family}, {comparison.tasks}"
    if series:
        tables = ["/".join(file.parts[-3:]) for line in lines for file in line.files]
        about += f"; from {', '.join(tables)}"
    return {
        "name": comparison.name,
        "about": about,
        "charts": [_chart(one) for one in adaptation_charts(comparison)],
        "profiles": _chart(profile_chart(comparison)),
        "tables": [table._asdict() for table in summary_tables(comparison)],
        "scatter": [
            {"label": line.label, "returns": rounded(line.column(-1).mean(axis=0))}
            for line in comparison.everyone
        ],
        "settings": _settings([line.label for line in lines], [line.settings for line in lines]),
    }


def _chart(chart: Chart) -> Document:
    shown = [curve for curve in chart.curves if np.isfinite(np.asarray(curve.mean, float)).any()]
    lines = [_line(curve) for curve in shown]
    about = {"title": chart.title, "x": chart.x, "y": chart.y, "log": chart.linear_to is not None}
    return about | {"lines": lines}


def _line(curve: Curve) -> Document:
    style = curve.style
    look = {"label": style.label, "colour": style.colour, "dash": _dash(style.line)}
    columns = {name: getattr(curve, name) for name in ("x", "mean", "low", "high")}
    return look | {name: rounded(column) for name, column in columns.items()}


def _dash(line: LineStyle) -> str:
    """Return Matplotlib's dash in plotly's words; nothing for circles without a line."""
    if isinstance(line, str):
        return {":": "dot", "--": "dash", "-.": "dashdot", "-": "solid"}.get(line, "")
    return ",".join(f"{3 * length:g}px" for length in line[1])


def _plane(run: RecordedRun) -> Document | None:
    """Return what is drawn in the plane of the world; None for what was not recorded."""
    explored = read_recorded(records.RecordedExploration, run.path / records.EXPLORATION)
    if explored is None:
        return None
    times = np.linspace(0, explored.prior_paths.shape[1] - 1, _SHOWN_POINTS).round().astype(int)
    panels = {
        "trained, z drawn": explored.prior_paths,
        "trained, z fixed": explored.fixed_paths,
        "untrained": explored.untrained_paths,
    }
    table = usual_table(run.path)
    adapted = table and read_recorded(records.Latents, latents_beside(table))
    ends = rounded(adapted.mean[:, -1]) if adapted else []
    paths = read_recorded(records.LatentPaths, run.path / records.LATENT_PATHS)
    searches = read_recorded(records.RecordedSearches, run.path / records.SEARCHES)
    return {
        "goals": rounded(explored.goals),
        "radius": explored.sparse_radius,
        "landmarks": rounded(explored.landmarks),
        "explorer": paths and {"adapted": ends, **_numbers(paths)},
        "search": searches and _numbers(searches),
        "panels": [
            {"title": title, "paths": rounded(paths[:_SHOWN_EPISODES, times])}
            for title, paths in panels.items()
            if paths is not None
        ],
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
