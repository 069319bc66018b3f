"""Moving and still pictures of episodes, side by side: rows of cells, each with a caption."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from maesn.report.style import BLACK, BLUISH_GREEN, DARK_GREY

Picture = UInt8[np.ndarray, "height width 3"]

# Pixels.
_MARGIN = 8
_TITLE_SIZE, _ROW_SIZE, _CAPTION_SIZE = 17, 15, 13
_LINE = 1.5  # height of a line of text in units of its size
_BORDER = 4
_WHITE = "#FFFFFF"
_COLOURS = 256  # of a GIF
_HOLD = 1500  # milliseconds that the last picture stays


@dataclass(frozen=True)
class Cell:
    """One episode."""

    caption: str
    success: bool
    """Whether the cell is framed as one that reached the goal."""
    pictures: Sequence[Picture]
    """As many as those of every other cell, all of one size."""


@dataclass(frozen=True)
class Row:
    """Episodes that belong together."""

    title: str
    cells: Sequence[Cell]


def film(title: str, rows: Sequence[Row], milliseconds: int) -> bytes:
    """Return an animated GIF in which all cells move at once, and which repeats for ever.

    Each picture is shown for so many milliseconds; the last one stays longer. There is at least one
    row, of at least one cell.
    """
    count = len(rows[0].cells[0].pictures)
    still = _compose(title, rows, count - 1)
    # One palette for all pictures: with palettes of their own, still areas would flicker.
    palette = still.quantize(_COLOURS, dither=Image.Dither.NONE)
    pictures = [
        _compose(title, rows, index).quantize(palette=palette, dither=Image.Dither.NONE)
        for index in range(count)
    ]
    content = io.BytesIO()
    pictures[0].save(
        content,
        "GIF",
        save_all=True,
        append_images=pictures[1:],
        duration=[milliseconds] * (count - 1) + [_HOLD],
        loop=0,
    )
    return content.getvalue()


def contact_sheet(title: str, rows: Sequence[Row]) -> bytes:
    """Return a PNG of the last picture of every cell."""
    content = io.BytesIO()
    _compose(title, rows, -1).save(content, "PNG")
    return content.getvalue()


def _compose(title: str, rows: Sequence[Row], index: int) -> Image.Image:
    height, width, _ = rows[0].cells[0].pictures[0].shape
    columns = max(len(row.cells) for row in rows)
    title_height, row_height = (round(_LINE * size) for size in (_TITLE_SIZE, _ROW_SIZE))
    below = round(_LINE * _CAPTION_SIZE) + _MARGIN
    sheet_width = columns * (width + _MARGIN) + _MARGIN
    sheet_height = title_height + 2 * _MARGIN + len(rows) * (row_height + height + below)
    sheet = Image.new("RGB", (sheet_width, sheet_height), _WHITE)
    draw = ImageDraw.Draw(sheet)
    _write(draw, (_MARGIN, _MARGIN), title, _TITLE_SIZE, BLACK, sheet_width)
    top = title_height + 2 * _MARGIN
    for row in rows:
        _write(draw, (_MARGIN, top), row.title, _ROW_SIZE, BLACK, sheet_width)
        top += row_height
        for column, cell in enumerate(row.cells):
            left = _MARGIN + column * (width + _MARGIN)
            _draw_cell(sheet, draw, cell, index, (left, top))
        top += height + below
    return sheet


def _draw_cell(
    sheet: Image.Image, draw: ImageDraw.ImageDraw, cell: Cell, index: int, corner: tuple[int, int]
) -> None:
    picture = cell.pictures[index]
    (left, top), (height, width, _) = corner, picture.shape
    sheet.paste(Image.fromarray(picture), corner)
    if cell.success:
        box = (left, top, left + width - 1, top + height - 1)
        draw.rectangle(box, outline=BLUISH_GREEN, width=_BORDER)
    colour = BLUISH_GREEN if cell.success else DARK_GREY
    _write(draw, (left, top + height), cell.caption, _CAPTION_SIZE, colour, left + width)


def _write(
    draw: ImageDraw.ImageDraw,
    corner: tuple[int, int],
    text: str,
    size: int,
    colour: str,
    right: int,
) -> None:
    """Write a line, smaller if it would reach beyond `right`."""
    width = right - corner[0]
    while size > 1 and _font(size).getlength(text) > width:
        size -= 1
    draw.text(corner, text, fill=colour, font=_font(size))


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(str(fonts / "DejaVuSans.ttf"), size)
