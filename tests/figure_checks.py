"""What tests of figures look at."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from synthetic_runs import run

from maesn.reporting.sources import Series, group_series
from maesn.reporting.style import METHOD_STYLES, save_figure


def check_saved_whole(figure: Figure, directory: Path) -> None:
    """Save a figure, and check that no label sticks out of it."""
    png, pdf = save_figure(figure, directory, "figure")
    assert png.read_bytes().startswith(b"\x89PNG")
    assert pdf.read_bytes().startswith(b"%PDF")
    assert min(file.stat().st_size for file in (png, pdf)) > 5000
    around = figure.get_tightbbox()  # inches
    width, height = figure.get_size_inches()
    assert around.x0 >= -0.01
    assert around.y0 >= -0.01
    assert around.x1 <= width + 0.01
    assert around.y1 <= height + 0.01


def crowd() -> list[Series]:
    """All methods, and two experiments that need long names."""
    wide, narrow = ({"context": {"initial_spread": spread}} for spread in (1.0, 0.0))
    variants = [run(learner=wide, episodes_per_task=50), run(learner=narrow, episodes_per_task=20)]
    return group_series([*variants, *(run(name) for name in METHOD_STYLES if name != "maesn")])


def legend(figure: Figure) -> list[str]:
    return [text.get_text().replace("\n", " ") for text in figure.legends[0].get_texts()]


def segments(axes: Axes) -> list[np.ndarray]:
    (lines,) = (child for child in axes.collections if isinstance(child, LineCollection))
    return [np.asarray(segment) for segment in lines.get_segments()]


def ellipses(axes: Axes) -> EllipseCollection:
    (found,) = (child for child in axes.collections if isinstance(child, EllipseCollection))
    return found


def line(axes: Axes, label: str) -> np.ndarray:
    (found,) = (one for one in axes.lines if one.get_label() == label)
    return np.asarray(found.get_xydata())
