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
_TITLE_SIZE, _ROW_SIZE, _CAPTION_SIZE = 17, 15, 13
_LINE = 1.5  # height of a line of text in units of its size
_BORDER = 4
_WHITE = 255
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
    drawn = [np.hstack([_cell(cell, index) for cell in row.cells]) for row in rows]
    width = max(cells.shape[1] for cells in drawn)
    below = np.full((_MARGIN, width, 3), _WHITE, np.uint8)
    parts = [_text(title, _TITLE_SIZE, BLACK, width), below]
    for row, cells in zip(rows, drawn, strict=True):
        beside = ((0, 0), (0, width - cells.shape[1]), (0, 0))
        parts.append(_text(row.title, _ROW_SIZE, BLACK, width))
        parts.append(np.pad(cells, beside, constant_values=_WHITE))
    margins = ((_MARGIN, 0), (_MARGIN, 0), (0, 0))
    return Image.fromarray(np.pad(np.vstack(parts), margins, constant_values=_WHITE))


def _cell(cell: Cell, index: int) -> Picture:
    """Return a picture with its caption, and a margin at the right and below."""
    picture = Image.fromarray(cell.pictures[index])
    if cell.success:
        frame = (0, 0, picture.width - 1, picture.height - 1)
        ImageDraw.Draw(picture).rectangle(frame, outline=BLUISH_GREEN, width=_BORDER)
    colour = BLUISH_GREEN if cell.success else DARK_GREY
    caption = _text(cell.caption, _CAPTION_SIZE, colour, picture.width)
    margins = ((0, _MARGIN), (0, _MARGIN), (0, 0))
    return np.pad(np.vstack([np.asarray(picture), caption]), margins, constant_values=_WHITE)


def _text(text: str, size: int, colour: str, width: int) -> Picture:
    """Return a line of text, smaller if it would not fit into the width."""
    line = Image.new("RGB", (width, round(_LINE * size)), "white")
    while size > 1 and _font(size).getlength(text) > width:
        size -= 1
    ImageDraw.Draw(line).text((0, 0), text, fill=colour, font=_font(size))
    return np.asarray(line)


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(str(fonts / "DejaVuSans.ttf"), size)
