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
    """Write a document of `run_page` or `study_page` as one HTML file.

    Raises:
        PlotlyMissing: plotly is not installed.
        RunError: the file cannot be written.
    """
    parts = {
        "style": _own("page.css"),
        "plotly": _plotly(),
        "data": script_json(document),
        "program": _own("page.js"),
    }
    page = _own("page.html")
    for name, content in parts.items():
        before, marker, after = page.partition(f"<!-- {name} -->")
        assert marker
        page = before + content + after
    write_whole(path, page.encode())


def script_json(document: Any) -> str:
    """Return JSON that may stand in a script element, whatever texts are in it."""
    text = json.dumps(_plain(document), allow_nan=False, separators=(",", ":"))
    # No text can then end the element, or begin a comment in it.
    return text.replace("<", "\\u003c")


def rounded(values: Any, digits: int = 3) -> list[Any]:
    """Return an array as nested lists of short numbers; None for NaN."""
    found: list[Any] = _plain(np.round(np.asarray(values, np.float64), digits))
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def _own(name: str) -> str:
    return files("maesn.reporting.page").joinpath(name).read_text("utf-8")


def _plotly() -> str:
    found = importlib.util.find_spec("plotly")
    if found is None or found.origin is None:
        raise PlotlyMissing(_WITHOUT_PLOTLY)
    return (Path(found.origin).parent / "package_data" / "plotly.min.js").read_text("utf-8")
