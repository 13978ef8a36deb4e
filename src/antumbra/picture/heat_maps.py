"""Heat maps: pixel values as colours on one scale, in labelled panels with a colour bar."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

# --- Pictures in panels, side by side, each below its lines of text, with a colour bar at the bottom ------------------


_PAPER, _INK, _FAINT = (30, 30, 34), (236, 236, 236), (160, 160, 166)
_NARROWEST = 240  # least width for a panel's labels, in pixels
_SMALLEST, _LARGEST = 7, 22  # font sizes, in pixels
_MOST = 4  # panels in a row


class Panel(NamedTuple):
    """A picture with its labels."""

    picture: np.ndarray  # (h, w, 3) uint8 sRGB
    lines: Sequence[str]  # text above the picture


class ColourBar(NamedTuple):
    """A colour bar with numbers."""

    colours: np.ndarray  # (k, 3) uint8 sRGB, from left to right
    ticks: Sequence[tuple[float, str]]  # place from 0 to 1, text
    caption: str


def sheet(panels: Sequence[Panel], bar: ColourBar) -> np.ndarray:
    """(H, W, 3) uint8 sRGB: panels of one size, with as many lines each, in rows; below them the colour bar."""
    from PIL import Image, ImageDraw

    h, w = panels[0].picture.shape[:2]
    letters, cell = letter_size(w), max(w, _NARROWEST)
    line, gap = round(1.4 * letters), letters
    above = gap // 2 + line * len(panels[0].lines) + gap // 4
    rows = -(-len(panels) // _MOST)
    columns, pitch = -(-len(panels) // rows), above + h + gap // 2
    width = gap + columns * (cell + gap)
    bar_image = draw_bar(bar, width - 2 * gap, letters)
    image = Image.new("RGB", (width, rows * pitch + len(bar_image) + gap // 2), _PAPER)
    draw = ImageDraw.Draw(image)
    for i, (picture, lines) in enumerate(panels):
        x, y = gap + i % columns * (cell + gap), i // columns * pitch
        for k, text in enumerate(lines):
            _write(draw, (x, y + gap // 2 + k * line), text, letters, cell, _FAINT if k else _INK)
        image.paste(Image.fromarray(picture), (x, y + above))
    image.paste(Image.fromarray(bar_image), (gap, rows * pitch))
    return np.asarray(image)


def draw_bar(bar: ColourBar, width: int, letters: int) -> np.ndarray:
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
    rights = [x + font.getlength(text) for x, (_, text) in zip(lefts, ticks)]

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


# --- Heat maps: numbers of pixels as colours, with one scale for several maps -----------------------------------------


# The colour map `plasma` of Nathaniel Smith and Stefan van der Walt (CC0), in sRGB. It is perceptually uniform. Its
# lowest colour differs from the black of pixels without a number.
_RAMP = np.array([
    [13, 8, 135], [49, 5, 151], [76, 2, 161], [102, 0, 167], [126, 3, 168], [149, 17, 161], [170, 35, 149],
    [188, 53, 135], [204, 71, 120], [218, 90, 106], [230, 108, 92], [240, 128, 78], [248, 149, 64], [253, 172, 51],
    [253, 197, 39], [248, 223, 37], [240, 249, 33],
], np.float64)  # fmt: skip
_PERCENTILE = 99.5  # of the numbers, where the scale ends, so that a few pixels do not make all others dark
_MOST_TICKS = 8
_ROUNDING = 1e-9  # relative: sums that differ by this from a tick are on it


def heat_colours(values: np.ndarray, top: float) -> np.ndarray:
    """(..., 3) uint8: the colours of numbers from 0 to `top`. Larger numbers get the colour of `top`."""
    at = np.clip(np.asarray(values, np.float64) / top, 0.0, 1.0) * (len(_RAMP) - 1)
    low = np.minimum(at.astype(np.int64), len(_RAMP) - 2)
    part = (at - low)[..., None]
    return np.round(_RAMP[low] * (1.0 - part) + _RAMP[low + 1] * part).astype(np.uint8)


def scale_of(values: np.ndarray) -> np.ndarray:
    """The ticks of a scale, from 0 to its end: at most nine round numbers."""
    top = float(np.percentile(values, _PERCENTILE)) if values.size else 0.0
    if not top > 0.0:
        return np.array([0.0, 1.0])
    step = 10.0 ** math.floor(math.log10(top / _MOST_TICKS))
    step *= next(k for k in (1, 2, 5, 10) if k * step * _MOST_TICKS >= top)
    return step * np.arange(math.ceil(top / step - _ROUNDING) + 1)


class Scale(NamedTuple):
    """The meaning of the colours of heat maps."""

    ticks: np.ndarray  # (k,) float64, rising numbers, from the scale's begin to its end
    logarithmic: bool
    beyond: bool = False  # whether some numbers lie beyond the end
    names: tuple[str, ...] = ()  # of numbers that stand for names: those of 0, 1, ..., instead of a scale

    def places(self, values: np.ndarray) -> np.ndarray:
        """(...) float64: 0 where the scale begins, 1 where it ends; beyond these for numbers beyond the scale."""
        if not self.logarithmic:
            return np.asarray(values, np.float64) / self.ticks[-1]
        with np.errstate(divide="ignore"):  # 0 lies infinitely far before the scale
            return np.log(np.asarray(values, np.float64) / self.ticks[0]) / math.log(self.ticks[-1] / self.ticks[0])

    def colours(self, values: np.ndarray, known: np.ndarray) -> np.ndarray:
        """(..., 3) uint8: the colours of numbers; black where they are not `known`."""
        return np.where(known[..., None], heat_colours(self.places(values), 1.0), np.uint8(0))

    def bar(self, caption: str) -> ColourBar:
        """The colour bar; `caption` is the meaning of the numbers."""
        if self.names:
            n = len(self.names)
            colours = heat_colours(self.places(np.arange(n)).repeat(-(-1024 // n)), 1.0)
            return ColourBar(colours, [((k + 0.5) / n, name) for k, name in enumerate(self.names)], caption)
        texts = [f"{tick:,.6g}" for tick in self.ticks]
        texts = [("<" if self.logarithmic else "") + texts[0], *texts[1:-1], texts[-1] + "+" * self.beyond]
        return ColourBar(
            heat_colours(np.linspace(0.0, 1.0, 1024), 1.0), [*zip(self.places(self.ticks), texts)], caption
        )


def linear_scale(values: np.ndarray) -> Scale:
    """A scale from 0 on for numbers, without a few extreme ones."""
    ticks = scale_of(values)
    return Scale(ticks, False, _beyond(values, ticks))


def _beyond(values: np.ndarray, ticks: np.ndarray) -> bool:
    """Whether some numbers lie beyond the last tick."""
    return bool(values.size and values.max() > ticks[-1] * (1.0 + _ROUNDING))


def log_scale_of(values: np.ndarray) -> Scale:
    """A logarithmic scale from 1, 2 or 5 times a power of ten to another such number, with all of these between."""
    positive = np.asarray(values)[np.asarray(values) > 0.0]
    low, top = np.percentile(positive, (100.0 - _PERCENTILE, _PERCENTILE)) if positive.size else (1.0, 1.0)
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(top))
    numbers = np.array([float(f"{k}e{e}") for e in range(first, last + 2) for k in (1, 2, 5)])
    begin = np.flatnonzero(numbers <= low)[-1]
    end = max(np.flatnonzero(numbers >= top)[0], begin + 1)
    ticks = numbers[begin : end + 1]
    return Scale(ticks, True, _beyond(positive, ticks))


def heat_map(
    panels: Sequence[np.ndarray], known: np.ndarray, labels: Sequence[Sequence[str]], caption: str
) -> np.ndarray:
    """Draw panels side by side, each below its lines of text, with a colour bar at the bottom.

    Parameters
    ----------
    panels : (h, w) float each, 0 or more
    known : (h, w) bool
        Pixels that have a number; others are black.
    labels : lines of text of each panel, as many for every panel
    caption : str
        The meaning of the numbers.

    Returns
    -------
    (H, W, 3) uint8 sRGB
    """
    scale = linear_scale(np.concatenate([panel[known] for panel in panels]))
    labelled_panels = [Panel(scale.colours(panel, known), lines) for panel, lines in zip(panels, labels)]
    return sheet(labelled_panels, scale.bar(caption))
