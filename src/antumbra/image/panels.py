"""Pictures in panels, side by side, each below its lines of text, with a colour bar at the bottom."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

_PAPER, _INK, _FAINT = (30, 30, 34), (236, 236, 236), (160, 160, 166)
_NARROWEST = 240  # least width for a panel's labels, in pixels
_SMALLEST, _LARGEST = 7, 22  # font sizes, in pixels
_MOST = 4  # panels in a row


class Panel(NamedTuple):
    """A picture with its labels."""

    picture: np.ndarray  # (h, w, 3) uint8 sRGB
    lines: Sequence[str]  # text above the picture


class Bar(NamedTuple):
    """A colour bar with numbers."""

    colours: np.ndarray  # (k, 3) uint8 sRGB, from left to right
    ticks: Sequence[tuple[float, str]]  # place from 0 to 1, text
    caption: str


def sheet(panels: Sequence[Panel], bar: Bar) -> np.ndarray:
    """(H, W, 3) uint8 sRGB: panels of one size, with as many lines each, in rows; below them the colour bar."""
    from PIL import Image, ImageDraw

    h, w = panels[0].picture.shape[:2]
    letters, cell = letter_size(w), max(w, _NARROWEST)
    line, gap = round(1.4 * letters), letters
    above = gap // 2 + line * len(panels[0].lines) + gap // 4
    rows = -(-len(panels) // _MOST)
    columns, pitch = -(-len(panels) // rows), above + h + gap // 2
    width = gap + columns * (cell + gap)
    drawn = draw_bar(bar, width - 2 * gap, letters)
    image = Image.new("RGB", (width, rows * pitch + len(drawn) + gap // 2), _PAPER)
    draw = ImageDraw.Draw(image)
    for i, (picture, lines) in enumerate(panels):
        x, y = gap + i % columns * (cell + gap), i // columns * pitch
        for k, text in enumerate(lines):
            _write(draw, (x, y + gap // 2 + k * line), text, letters, cell, _FAINT if k else _INK)
        image.paste(Image.fromarray(picture), (x, y + above))
    image.paste(Image.fromarray(drawn), (gap, rows * pitch))
    return np.asarray(image)


def draw_bar(bar: Bar, width: int, letters: int) -> np.ndarray:
    """(H, width, 3) uint8 sRGB: a caption, the colours, and numbers below them, in letters of so many pixels."""
    from PIL import Image, ImageDraw

    line = round(1.4 * letters)
    image = Image.new("RGB", (width, 2 * line + letters), _PAPER)
    draw = ImageDraw.Draw(image)
    _write(draw, (0, 0), bar.caption, letters, width, _INK)
    at = np.linspace(0, len(bar.colours) - 1, width).round().astype(np.int64)
    image.paste(Image.fromarray(np.broadcast_to(bar.colours[at], (letters, width, 3)).copy()), (0, line))
    _write_ticks(draw, bar.ticks, line + letters, width, letters)
    return np.asarray(image)


def blank(shape: tuple[int, int], text: str) -> np.ndarray:
    """(h, w, 3) uint8 sRGB: a grey panel with a line of text in its middle, instead of a picture."""
    from PIL import Image, ImageDraw

    (h, w), size = shape, letter_size(shape[1])
    image = Image.new("RGB", (w, h), tuple(2 * c for c in _PAPER))
    _write(ImageDraw.Draw(image), (size, h // 2 - size), text, size, w - 2 * size, _FAINT)
    return np.asarray(image)


def letter_size(width: int) -> int:
    """The font size, in pixels, for panels of a width."""
    return min(max(width // 24, 13), _LARGEST)


def _write_ticks(draw, ticks: Sequence[tuple[float, str]], y: int, length: int, letters: int) -> None:
    """Draw the numbers under a bar: as many, evenly chosen, as have room."""
    font, last = _font(letters), len(ticks) - 1
    lefts = [min(max(length * at - font.getlength(text) / 2, 0), length - font.getlength(text)) for at, text in ticks]
    rights = [left + font.getlength(text) for left, (_, text) in zip(lefts, ticks)]

    def fits(every: int) -> bool:
        chosen = range(0, last + 1, every)
        return all(rights[i] + letters / 2 <= lefts[j] for i, j in pairwise(chosen))

    every = next((k for k in range(1, last) if last % k == 0 and fits(k)), max(last, 1))
    for i in range(0, last + 1, every):
        draw.text((lefts[i], y + letters // 6), ticks[i][1], _FAINT, font)


def _write(draw, at: tuple[int, int], text: str, letters: int, width: int, colour) -> None:
    """Draw a line of text in the largest font size, up to `letters` pixels, that fits into `width`."""
    while letters > _SMALLEST and _font(letters).getlength(text) > width:
        letters -= 1
    draw.text(at, text, colour, _font(letters))


def _font(letters: int):
    from PIL import ImageFont

    return ImageFont.load_default(letters)
