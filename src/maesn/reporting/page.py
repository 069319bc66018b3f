"""The report page: one HTML file that shows runs or a study, and needs no network."""

import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from maesn.reporting import runs as records
from maesn.reporting.comparison import Comparison, Line
from maesn.reporting.figures.curves import (
    Chart,
    adaptation_charts,
    belief_chart,
    learning_charts,
    plot_charts,
    profile_chart,
)
from maesn.reporting.reading import count_of, latents_beside, usual_table
from maesn.reporting.runs import RecordedRun, read_recorded
from maesn.reporting.sources import Compared, Series
from maesn.reporting.style import ONE_COLUMN, publication_style, rendered
from maesn.reporting.tables import UNITS, summary_tables
from maesn.settings import leaves
from maesn.storage import read_arrays, read_json, write_whole

Document = dict[str, Any]

PAGE = "report.html"

_SHOWN_EPISODES, _SHOWN_POINTS = 50, 40


def write_page(directory: Path, document: Document) -> Path:
    """Write a document of `page_of` as one HTML file, and return its path."""
    own, text = files("maesn.reporting"), json.dumps(document, allow_nan=False)
    page = own.joinpath("page.html").read_text("utf-8")
    for name, content in {
        "style": own.joinpath("page.css").read_text("utf-8"),
        "data": text.replace("<", "\\u003c"),  # no text can end the element, or begin a comment
        "elements": own.joinpath("elements.js").read_text("utf-8"),
        "program": own.joinpath("page.js").read_text("utf-8"),
    }.items():
        page = page.replace(f"<!-- {name} -->", content, 1)
    write_whole(directory / PAGE, page.encode())
    return directory / PAGE


def page_of(study: Compared) -> Document:
    """Return the document of the page of a study, or of one or several runs.

    Latents and paths of runs are those of the first run that has recorded latents, the belief that
    of the first that has recorded one. A `RunError` says which file is missing or broken.
    """
    headlines = []
    for one in study.comparisons:
        shown = one.lines
        if not study.series:  # of a study the best line alone: it may have many
            shown = (max(one.lines, key=lambda line: float(line.column(-1).mean())),)
        headlines += [_headline(line, one) for line in shown]
    compared = [_comparison(one, study.series) for one in study.comparisons]
    document = {"headlines": headlines, "comparisons": compared}
    if study.series:
        return document | _of_runs(study.series)
    names = ", ".join(one.name for one in study.comparisons) or "nothing compared yet"
    rows = [*map(list, study.study["versions"].items())]
    rows += [["job", job] for job in study.study["jobs"]]
    provenance = {"columns": ["", "value"], "rows": rows}
    title = f"Study {study.study['study']}"
    return document | {"title": title, "subtitle": names, "provenance": provenance}


def _headline(line: Line, comparison: Comparison) -> Document:
    """Return how a line begins and ends: a number, and words."""
    (first, last), *success = (
        [UNITS[name].number(line.column(at, name).mean()) for at in (0, -1)]
        for name in comparison.headline_measures
    )
    learned = f"after {count_of(line.table.episodes[-1])} in the new task"
    number, text = last, f"is the mean return {learned}, {first} at first"
    if success:
        ((before, after),) = success
        number = f"{after} %"
        text = f"of the episodes reach the goal {learned}, {before} % at first; "
        text += f"the mean return goes from {first} to {last}"
    return {"number": number, "name": f"{line.label}, {comparison.name}", "text": text}


def _of_runs(series: Sequence[Series]) -> Document:
    runs = [run for one in series for run in one.runs]
    latents, beliefs = (
        [run for run in runs if (run.path / file).exists()]
        for file in (records.LATENT_PATHS, records.BELIEF)
    )
    shown, *_ = (*latents, *beliefs, runs[0])
    believing, *_ = (*beliefs, shown)
    names = [run.path.resolve().name for run in runs]
    charts = [chart for charts in learning_charts(series).values() for chart in charts]
    return {
        "title": f"{' and '.join(one.style.label for one in series)} on {shown.family}",
        "subtitle": ", ".join(names),
        "plane": _plane(shown, believing),
        "learning": [*map(_chart, charts)],
        "provenance": _settings(names, [leaves(read_json(x.path / "config.json")) for x in runs]),
    }


def _comparison(comparison: Comparison, series: Sequence[Series]) -> Document:
    lines, about = comparison.lines, f"{comparison.family}, {comparison.tasks}"
    if series:
        tables = ["/".join(file.parts[-3:]) for line in lines for file in line.files]
        about += f"; from {', '.join(tables)}"
    return {
        "name": comparison.name,
        "about": about,
        "charts": [*map(_chart, [*adaptation_charts(comparison), profile_chart(comparison)])],
        "tables": [table._asdict() for table in summary_tables(comparison)],
        "scatter": [
            {"label": line.label, "returns": rounded(line.column(-1).mean(axis=0))}
            for line in comparison.everyone
        ],
        "settings": _settings([line.label for line in lines], [line.settings for line in lines]),
    }


def _chart(chart: Chart) -> Document:
    lines = ", ".join(curve.style.label for curve in chart.curves)
    with publication_style():
        figure = plot_charts([chart], width=ONE_COLUMN)
        picture = rendered(figure, "svg").decode()
    return {"svg": picture, "about": f"{chart.title} {chart.y} over {chart.x}: {lines}".strip()}


def _plane(run: RecordedRun, believing: RecordedRun) -> Document | None:
    """Return what is drawn in the plane of the world; None for what was not recorded.

    The belief is that of the second run.
    """
    explored = read_recorded(records.RecordedExploration, run.path / records.EXPLORATION)
    if explored is None:
        return None
    times = np.linspace(0, explored.prior_paths.shape[1] - 1, _SHOWN_POINTS).round().astype(int)
    panels = {
        "trained" if explored.fixed_paths is None else "trained, z drawn": explored.prior_paths,
        "trained, z fixed": explored.fixed_paths,
        "untrained": explored.untrained_paths,
    }
    table = usual_table(run.path)
    adapted = table and read_recorded(records.Latents, latents_beside(table))
    ends = rounded(adapted.mean[:, -1]) if adapted else []
    paths, searches = (_arrays(run.path / x) for x in (records.LATENT_PATHS, records.SEARCHES))
    belief = _arrays(believing.path / records.BELIEF)
    return {
        "goals": rounded(explored.goals),
        "radius": explored.sparse_radius,
        "landmarks": rounded(explored.landmarks),
        "explorer": paths and {"adapted": ends, **paths},
        "search": searches,
        "belief": belief and {"chart": _chart(belief_chart(belief)), **belief},
        "panels": [
            {"title": title, "paths": rounded(paths[:_SHOWN_EPISODES, times])}
            for title, paths in panels.items()
            if paths is not None
        ],
    }


def _arrays(file: Path) -> Document | None:
    """Return what `maesn report` has recorded in a file; None if there is none."""
    if not file.exists():
        return None
    return {name: rounded(x) for name, x in read_arrays(file, records.REMEDY).items()}


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
