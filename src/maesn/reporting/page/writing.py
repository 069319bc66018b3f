"""Writes the page: a template, its style and its program, plotly, and the data as JSON."""

import importlib.util
import json
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from maesn.storage import RunError, write_whole

PAGE = "report.html"
_WITHOUT_PLOTLY = (
    "no page is written, because plotly is missing: install it with `pip install 'maesn[page]'`."
)


class PlotlyMissing(RunError):
    """The page needs plotly, an extra of the installation."""


def write_page(path: Path, document: Mapping[str, Any]) -> None:
    """Write a document of `run_page` or `study_page` as one HTML file; that may be refused.

    Raises:
        PlotlyMissing: plotly is not installed.
    """
    parts = {
        "style": _own("page.css"),
        "plotly": _plotly(),
        "data": script_json(document),
        "program": _own("page.js"),
    }
    page = _own("page.html")
    for name, content in parts.items():
        page = page.replace(f"<!-- {name} -->", content, 1)
    write_whole(path, page.encode())


def script_json(document: Any) -> str:
    """Return JSON that may stand in a script element, whatever texts are in it."""
    text = json.dumps(document, allow_nan=False, separators=(",", ":"))
    # No text can then end the element, or begin a comment in it.
    return text.replace("<", "\\u003c")


def rounded(values: Any, digits: int = 3) -> Any:
    """Return an array as nested lists of short numbers; None for NaN."""
    numbers = np.asarray(values, np.float64)
    found = numbers.round(digits).astype(object)
    return np.where(np.isfinite(numbers), found, np.array(None)).tolist()


def _own(name: str) -> str:
    return files("maesn.reporting.page").joinpath(name).read_text("utf-8")


def _plotly() -> str:
    found = importlib.util.find_spec("plotly")
    if found is None or found.origin is None:
        raise PlotlyMissing(_WITHOUT_PLOTLY)
    return (Path(found.origin).parent / "package_data" / "plotly.min.js").read_text("utf-8")
