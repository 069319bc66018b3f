"""The look of figures: different without colour, and nobody else's settings touched."""

import itertools
from pathlib import Path

import matplotlib as mpl
from matplotlib.colors import to_rgb

from maesn.reporting.style import (
    METHOD_STYLES,
    TWO_COLUMNS,
    MethodStyle,
    new_figure,
    publication_style,
    save_figure,
    series_styles,
)


def luminance(style: MethodStyle) -> float:
    red, green, blue = to_rgb(style.colour)
    return 0.299 * red + 0.587 * green + 0.114 * blue


def test_any_two_methods_differ_without_colour() -> None:
    for first, second in itertools.combinations(METHOD_STYLES.values(), 2):
        assert first.marker != second.marker
        # A grey printer leaves lightness and dashes.
        assert first.line != second.line or abs(luminance(first) - luminance(second)) > 0.05


def test_repeated_and_unknown_methods_get_looks_of_their_own() -> None:
    styles = series_styles(["maesn", "maesn", "mine", "maesn"])
    assert [style.label for style in styles] == ["MAESN", "MAESN", "mine", "MAESN"]
    assert len({(style.colour, style.line, style.marker) for style in styles}) == 4


def test_the_users_settings_are_left_alone_and_not_used(tmp_path: Path) -> None:
    with mpl.rc_context({"font.size": 31.0, "axes.grid": False, "figure.facecolor": "red"}):
        before = dict(mpl.rcParams)
        with publication_style():
            axes = new_figure(2.0, 1.0).subplots()
        save_figure(axes.figure, tmp_path, "figure")
        assert dict(mpl.rcParams) == before
    assert axes.xaxis.label.get_fontsize() == 8.0
    assert axes.figure.get_facecolor() == (1.0, 1.0, 1.0, 1.0)


def test_files_are_repeatable_sized_and_embed_their_fonts(tmp_path: Path) -> None:
    for name in ("first", "second"):
        with publication_style():
            figure = new_figure(TWO_COLUMNS, 2.0)
            figure.subplots().set_xlabel("update")
        save_figure(figure, tmp_path / "new" / "directory", name)
    folder = tmp_path / "new" / "directory"
    for suffix in ("png", "pdf"):
        first, second = (folder / f"{name}.{suffix}" for name in ("first", "second"))
        assert first.read_bytes() == second.read_bytes()
    document = (folder / "first.pdf").read_bytes()
    assert b"/FontFile2" in document  # TrueType, embedded
    assert b"/Type3" not in document
    header = (folder / "first.png").read_bytes()[16:24]  # width and height of a PNG
    assert int.from_bytes(header[:4], "big") == round(300 * TWO_COLUMNS)
    assert int.from_bytes(header[4:], "big") == 600
