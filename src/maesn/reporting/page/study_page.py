"""What the page of a study says."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from maesn.reporting.comparison import Comparison, summary_tables
from maesn.reporting.page.charts import adaptation_charts, profile_chart
from maesn.reporting.page.writing import rounded
from maesn.reporting.study import read_comparisons


def study_page(directory: Path) -> dict[str, Any]:
    """Return the document of the page of a study.

    Raises:
        RunError: a file is missing or damaged.
    """
    manifest, compared = read_comparisons(directory)
    return {
        "title": f"Study {manifest['study']}",
        "subtitle": ", ".join(world["name"] for world, _ in compared) or "nothing compared yet",
        "comparisons": [_comparison(world, one) for world, one in compared],
        "provenance": {
            "columns": ["", "value"],
            "rows": [
                ["command", f"maesn study run {manifest['study']}"],
                *([name, version] for name, version in manifest.get("versions", {}).items()),
                *(["job", job] for job in manifest["jobs"]),
            ],
        },
    }


def _comparison(world: Mapping[str, Any], comparison: Comparison) -> dict[str, Any]:
    """Return charts, tables and the tasks' returns of one comparison."""
    return {
        "name": world["name"],
        "about": f"{world['family']}, {world['tasks']} tasks, {world['reward']} reward",
        "charts": [*adaptation_charts(comparison.lines), profile_chart(comparison.lines)],
        "tables": [table._asdict() for table in summary_tables(comparison)],
        "scatter": [
            {
                "label": line.label,
                "returns": rounded(line.measure("mean_return")[..., -1].mean(axis=0)),
            }
            for line in comparison.everyone
        ],
        "settings": _settings(world["lines"]),
    }


def _settings(lines: list[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the settings of each line, a column each; first those in which lines differ."""
    columns = [
        {
            **{f"evaluation.{name}": value for name, value in line.get("evaluation", {}).items()},
            **line.get("settings", {}),
        }
        for line in lines
    ]
    names = dict.fromkeys(name for column in columns for name in column)
    rows = [[name, *(_text(column.get(name)) for column in columns)] for name in names]
    differing = [row for row in rows if len(set(row[1:])) > 1]
    return {
        "columns": ["setting", *(line["label"] for line in lines)],
        "rows": [*differing, *(row for row in rows if row not in differing)],
        "differing": len(differing),
    }


def _text(value: Any) -> str:
    return "" if value is None else str(value)
