"""The look of all figures: colours, sizes, files.

Figures are drawn at the width at which they are printed. Methods differ in colour (Okabe and Ito,
"Color universal design", 2008: distinguishable with every common colour blindness), in lightness,
line style and marker, so that they survive a grey printer. Matplotlib's global state never changes.
"""

import io
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import matplotlib.style
from matplotlib.figure import Figure

from maesn.storage import write_whole

ONE_COLUMN = 3.3  # inches; one column of a two-column page
TWO_COLUMNS = 6.8

BLACK = "#000000"
ORANGE = "#E69F00"
SKY_BLUE = "#56B4E9"
BLUISH_GREEN = "#009E73"
BLUE = "#0072B2"
VERMILLION = "#D55E00"
REDDISH_PURPLE = "#CC79A7"
GREY = "#7F7F7F"
DARK_GREY = "#444444"

LineStyle: TypeAlias = str | tuple[int, tuple[float, ...]]
_LONG_DASH = (0, (6.0, 1.5))
_DASH_DOT_DOT = (0, (5.0, 1.2, 1.2, 1.2, 1.2, 1.2))
_DASHES = ("-", "--", ":", "-.", _LONG_DASH, _DASH_DOT_DOT)


@dataclass(frozen=True)
class MethodStyle:
    """The look of one method's lines."""

    label: str
    colour: str = DARK_GREY
    line: LineStyle = ":"
    marker: str = "."

    def variant(self, number: int, label: str) -> "MethodStyle":
        """Return the style of the method's line of that number, from 0: each has other dashes."""
        dashes = _DASHES[number % len(_DASHES)] if number else self.line
        return replace(self, label=label, line=dashes)


METHOD_STYLES = {
    "maesn": MethodStyle("MAESN", VERMILLION, "-", "o"),
    "maesn_theta": MethodStyle("MAESN + θ", ORANGE, _LONG_DASH, "D"),
    "latent_space": MethodStyle("LatentSpace", BLUE, "-.", "s"),
    "maml": MethodStyle("MAML", BLUISH_GREEN, _LONG_DASH, "^"),
    "maml_bias": MethodStyle("MAML + bias", SKY_BLUE, _DASH_DOT_DOT, "v"),
    "maml_bias_only": MethodStyle("MAML (bias only)", REDDISH_PURPLE, ":", "P"),
    "rl2": MethodStyle("RL²", BLACK, "--", "X"),
    "rl2_trpo": MethodStyle("RL² (TRPO)", BLACK, ":", "p"),
    "varibad": MethodStyle("VariBAD", REDDISH_PURPLE, "-.", "d"),
    "pearl": MethodStyle("PEARL", SKY_BLUE, "-", "8"),
    "vime": MethodStyle("VIME", ORANGE, "--", "h"),
    "trpo": MethodStyle("TRPO", GREY, "-.", "<"),
    "reinforce": MethodStyle("REINFORCE", GREY, ":", ">"),
    "oracle": MethodStyle("oracle", DARK_GREY, "-", "*"),
}


def series_styles(methods: Sequence[str]) -> list[MethodStyle]:
    """Return a style for each series of a figure.

    The first series of a method gets the method's own; any other one has the colour of a method
    that the figure does not show, in other dashes.
    """
    unused = [style for method, style in METHOD_STYLES.items() if method not in methods]
    spare, styles = itertools.cycle(unused or METHOD_STYLES.values()), []
    for position, method in enumerate(methods):
        own = METHOD_STYLES.get(method, MethodStyle(method))
        is_first = method in METHOD_STYLES and method not in methods[:position]
        styles.append(own if is_first else next(spare).variant(position, own.label))
    return styles


# Inside this block, figures have this style, whatever the user's own Matplotlib settings are.
publication_style = partial(matplotlib.style.context, ["default", "maesn.reporting.publication"])


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure that no window system knows of; sizes in inches."""
    return Figure(figsize=(width, height), layout="compressed")


def settle(figure: Figure) -> None:
    """Lay a figure out for good. Panels with equal scales settle in two passes; a third is safe."""
    for _ in range(3):
        figure.draw_without_rendering()
    figure.set_layout_engine("none")


def save_figure(figure: Figure, directory: Path, name: str) -> list[Path]:
    """Write `<name>.png` and `<name>.pdf`, and return their paths.

    The same figure gives the same bytes every time.
    """
    files = [directory / f"{name}.{suffix}" for suffix in ("png", "pdf")]
    with publication_style():
        settle(figure)
        for file in files:
            write_whole(file, rendered(figure, file.suffix[1:]))
    return files


def rendered(figure: Figure, kind: str) -> bytes:
    """Return a figure as `png`, `pdf` or `svg`."""
    content = io.BytesIO()
    undated: dict[str, Any] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
    figure.savefig(content, format=kind, metadata=undated.get(kind), transparent=kind == "svg")
    return content.getvalue()
