"""Moving and still pictures of episodes, side by side: rows of cells, each with a caption."""

import io
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from maesn.reporting.style import BLACK, BLUISH_GREEN, DARK_GREY

Picture = UInt8[np.ndarray, "height width 3"]

# Pixels.
_MARGIN = 8
_TITLE, _ROW, _CAPTION = 26, 22, 20  # heights of lines of text
_LINE = 1.5  # height of a line in units of the size of its text
_BORDER = 4
_COLOURS = 256  # of a GIF
_HOLD = 1500  # milliseconds that the last picture stays


class Cell(NamedTuple):
    """One episode."""

    caption: str
    success: bool
    """Whether the cell is framed as one that reached the goal."""
    pictures: Sequence[Picture]
    """As many as those of every other cell, all of one size."""


class Row(NamedTuple):
    """Episodes that belong together."""

    title: str
    cells: Sequence[Cell]


def film(title: str, rows: Sequence[Row], milliseconds: int) -> bytes:
    """Return an animated GIF in which all cells move at once, and which repeats for ever.

    Each picture is shown for so many milliseconds; the last one stays longer. There is at least one
    row, of at least one cell.
    """
    count = len(rows[0].cells[0].pictures)
    # One palette for all pictures: with palettes of their own, still areas would flicker.
    palette = _compose(title, rows, -1).quantize(_COLOURS, dither=Image.Dither.NONE)
    sheets = (_compose(title, rows, index) for index in range(count))
    first, *others = (sheet.quantize(palette=palette, dither=Image.Dither.NONE) for sheet in sheets)
    durations = [milliseconds] * (count - 1) + [_HOLD]
    content = io.BytesIO()
    first.save(content, "GIF", save_all=True, append_images=others, duration=durations, loop=0)
    return content.getvalue()


def contact_sheet(title: str, rows: Sequence[Row]) -> bytes:
    """Return a PNG of the last picture of every cell."""
    content = io.BytesIO()
    _compose(title, rows, -1).save(content, "PNG")
    return content.getvalue()


def _compose(title: str, rows: Sequence[Row], index: int) -> Image.Image:
    """Return the cells' pictures of one index, with their texts, on one sheet."""
    height, width, _ = rows[0].cells[0].pictures[0].shape
    down, across = _ROW + height + _CAPTION + _MARGIN, width + _MARGIN
    right = max(len(row.cells) for row in rows) * across
    sheet = Image.new("RGB", (_MARGIN + right, 2 * _MARGIN + _TITLE + len(rows) * down), "white")
    draw = ImageDraw.Draw(sheet)
    _write(draw, _MARGIN, _MARGIN, title, _TITLE, BLACK, right)
    for line, row in enumerate(rows):
        top = 2 * _MARGIN + _TITLE + line * down
        _write(draw, _MARGIN, top, row.title, _ROW, BLACK, right)
        for column, cell in enumerate(row.cells):
            x, y = _MARGIN + column * across, top + _ROW
            sheet.paste(Image.fromarray(cell.pictures[index]), (x, y))
            colour = BLUISH_GREEN if cell.success else DARK_GREY
            if cell.success:
                frame = (x, y, x + width - 1, y + height - 1)
                draw.rectangle(frame, outline=colour, width=_BORDER)
            _write(draw, x, y + height, cell.caption, _CAPTION, colour, width)
    return sheet


def _write(
    draw: ImageDraw.ImageDraw, x: int, y: int, text: str, height: int, colour: str, width: int
) -> None:
    """Write a line of text, smaller if it would not fit into the width."""
    size = round(height / _LINE)
    while size > 1 and _font(size).getlength(text) > width:
        size -= 1
    draw.text((x, y), text, fill=colour, font=_font(size))


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(str(fonts / "DejaVuSans.ttf"), size)
