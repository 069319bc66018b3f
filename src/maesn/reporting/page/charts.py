"""Curves as the page draws them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from maesn.reporting.adaptation_table import Line
from maesn.reporting.page.writing import rounded
from maesn.reporting.statistics import Interval, mean_intervals, performance_profile
from maesn.reporting.style import LineStyle, MethodStyle

_MOST_POINTS = 300  # of a curve: more are not seen
_THRESHOLDS = 101
_DASHES = {"-": "solid", "--": "dash", ":": "dot"}


def chart(title: str, x: str, y: str, lines: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return a chart of lines; `title` and axes are its texts."""
    return {"title": title, "x": x, "y": y, "lines": list(lines)}


def curve(style: MethodStyle, x: Any, intervals: Sequence[Interval]) -> dict[str, Any]:
    """Return a line with its interval."""
    ends = np.array([(one.mean, one.low, one.high) for one in intervals]).T
    return plain_curve(style, x, *ends)


def plain_curve(
    style: MethodStyle, x: Any, mean: Any, low: Any = None, high: Any = None
) -> dict[str, Any]:
    """Return a line; with a band between `low` and `high` if they are given."""
    kept = np.unique(np.linspace(0, len(x) - 1, _MOST_POINTS).round().astype(int))
    columns = {"x": x, "mean": mean, "low": low, "high": high}
    return {
        "label": style.label,
        "colour": style.colour,
        "dash": dash(style.line),
        **{
            name: [] if column is None else rounded(np.asarray(column)[kept])
            for name, column in columns.items()
        },
    }


def adaptation_charts(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """Return the charts of return and success over the episodes in the new task."""
    texts = {"mean_return": f"mean {lines[0].table.reward} return", "success_rate": "success rate"}
    return [
        chart(
            text,
            "episodes in the new task",
            text,
            [
                curve(line.style, line.table.episodes, mean_intervals(line.measure(measure)))
                for line in lines
            ],
        )
        for measure, text in texts.items()
    ]


def profile_chart(lines: Sequence[Line]) -> dict[str, Any]:
    """Return, for each return, in which share of tasks and seeds a line ends above it."""
    ends = [line.measure("mean_return")[..., -1] for line in lines]
    thresholds = np.linspace(min(map(np.min, ends)), max(map(np.max, ends)), _THRESHOLDS)
    return chart(
        "Where tasks end",
        "return τ",
        "share of tasks that end above τ",
        [
            curve(line.style, thresholds, performance_profile(last, thresholds))
            for line, last in zip(lines, ends, strict=True)
        ],
    )


def dash(line: LineStyle) -> str:
    """Return Matplotlib's dash in plotly's words."""
    if isinstance(line, str):
        return _DASHES.get(line, "solid")
    return ",".join(f"{3 * length:g}px" for length in line[1])
