"""Heat maps: pixel values in false colours on a common scale, in labelled panels with a colour bar."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

# --- Panels and colour bars -------------------------------------------------------------------------------------------

RGB = tuple[int, int, int]
_MIN_WIDTH = 240  # of a panel's labels, in pixels
_MIN_FONT, _MAX_FONT = 7, 22  # sizes in pixels
_COLUMNS = 4  # panels in a row, at most


class Paper(NamedTuple):
    """The colours of a sheet around its panels, in sRGB."""

    ground: RGB
    ink: RGB
    faint: RGB  # of numbers and further lines


DARK = Paper((30, 30, 34), (236, 236, 236), (160, 160, 166))
LIGHT = Paper((240, 240, 241), (28, 28, 32), (84, 84, 90))
"""Of studies, which people print and put into reports."""


class Panel(NamedTuple):
    """A picture with its labels."""

    picture: NDArray[np.uint8]  # (h, w, 3) sRGB
    lines: Sequence[str]  # text above the picture


class ColourBar(NamedTuple):
    """A colour bar with numbers."""

    colours: NDArray[np.uint8]  # (k, 3) sRGB, from left to right
    ticks: Sequence[tuple[float, str]]  # position from 0 to 1, text
    caption: str


def panel_sheet(panels: Sequence[Panel], bar: ColourBar, paper: Paper = DARK) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 sRGB: rows of panels above a colour bar. All panels have one size and number of lines."""
    from PIL import Image, ImageDraw

    h, w = panels[0].picture.shape[:2]
    letters, cell = letter_size(w), max(w, _MIN_WIDTH)
    line, gap = round(1.4 * letters), letters
    above = gap // 2 + line * len(panels[0].lines) + gap // 4
    rows = -(-len(panels) // _COLUMNS)
    columns, pitch = -(-len(panels) // rows), above + h + gap // 2
    width = gap + columns * (cell + gap)
    bar_image = draw_bar(bar, width - 2 * gap, letters, paper)
    image = Image.new("RGB", (width, rows * pitch + len(bar_image) + gap // 2), paper.ground)
    draw = ImageDraw.Draw(image)
    for i, (picture, lines) in enumerate(panels):
        x, y = gap + i % columns * (cell + gap), i // columns * pitch
        for k, text in enumerate(lines):
            _write(draw, (x, y + gap // 2 + k * line), text, letters, cell, paper.faint if k else paper.ink)
        image.paste(Image.fromarray(picture), (x, y + above))
    image.paste(Image.fromarray(bar_image), (gap, rows * pitch))
    return np.asarray(image)


def draw_bar(bar: ColourBar, width: int, letters: int, paper: Paper = DARK) -> NDArray[np.uint8]:
    """(H, width, 3) uint8 sRGB: a caption, the colours, and numbers below them; `letters`: font size in pixels."""
    from PIL import Image, ImageDraw

    line = round(1.4 * letters)
    image = Image.new("RGB", (width, 2 * line + letters), paper.ground)
    draw = ImageDraw.Draw(image)
    _write(draw, (0, 0), bar.caption, letters, width, paper.ink)
    at = np.linspace(0, len(bar.colours) - 1, width).round().astype(np.int64)
    image.paste(Image.fromarray(np.broadcast_to(bar.colours[at], (letters, width, 3)).copy()), (0, line))
    _write_ticks(draw, bar.ticks, line + letters, letters, width, paper.faint)
    return np.asarray(image)


def blank_panel(shape: tuple[int, int], text: str) -> NDArray[np.uint8]:
    """(h, w, 3) uint8 sRGB: a grey panel with a line of text in the middle, in place of a picture."""
    from PIL import Image, ImageDraw

    (h, w), size = shape, letter_size(shape[1])
    image = Image.new("RGB", (w, h), tuple(2 * c for c in DARK.ground))
    _write(ImageDraw.Draw(image), (size, h // 2 - size), text, size, w - 2 * size, DARK.faint)
    return np.asarray(image)


def letter_size(width: int) -> int:
    """The font size, in pixels, for panels of this width."""
    return min(max(width // 24, 13), _MAX_FONT)


def _write_ticks(
    draw: "ImageDraw", ticks: Sequence[tuple[float, str]], y: int, letters: int, length: int, colour: RGB
) -> None:
    """Draw the numbers under a bar: every k-th, with the smallest k for which they fit."""
    font, last = _font(letters), len(ticks) - 1
    lefts = [min(max(length * at - font.getlength(text) / 2, 0), length - font.getlength(text)) for at, text in ticks]
    rights = [x + font.getlength(text) for x, (_, text) in zip(lefts, ticks)]

    def fits(every: int) -> bool:
        chosen = range(0, last + 1, every)
        return all(rights[i] + letters / 2 <= lefts[j] for i, j in pairwise(chosen))

    every = next((k for k in range(1, last) if last % k == 0 and fits(k)), max(last, 1))
    for i in range(0, last + 1, every):
        draw.text((lefts[i], y + letters // 6), ticks[i][1], colour, font)


def _write(draw: "ImageDraw", at: tuple[int, int], text: str, letters: int, width: int, colour: RGB) -> None:
    """Draw a line of text in the largest font size, at most `letters` pixels, that fits into `width`."""
    while letters > _MIN_FONT and _font(letters).getlength(text) > width:
        letters -= 1
    draw.text(at, text, colour, _font(letters))


def _font(letters: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(letters)


# --- False colours and scales -----------------------------------------------------------------------------------------

RAMP = np.array([
    [13, 8, 135], [49, 5, 151], [76, 2, 161], [102, 0, 167], [126, 3, 168], [149, 17, 161], [170, 35, 149],
    [188, 53, 135], [204, 71, 120], [218, 90, 106], [230, 108, 92], [240, 128, 78], [248, 149, 64], [253, 172, 51],
    [253, 197, 39], [248, 223, 37], [240, 249, 33],
], np.float64)  # fmt: skip
"""The colour map `plasma` by Nathaniel Smith and Stefan van der Walt (CC0), in sRGB.

It is perceptually uniform, and its lowest colour differs from the black of pixels without a value.
"""

_PERCENTILE = 99.5  # of the values: end of the scale, so that a few bright pixels do not darken all others
_MOST_TICKS = 8
_ROUNDING = 1e-9  # relative: values this close to a tick lie on it


def heat_colours(values: np.ndarray, top: float) -> NDArray[np.uint8]:
    """(..., 3) uint8: false colours of values from 0 to `top`. Larger values get the colour of `top`."""
    at = np.clip(np.asarray(values, np.float64) / top, 0.0, 1.0) * (len(RAMP) - 1)
    index = np.minimum(at.astype(np.int64), len(RAMP) - 2)
    fraction = (at - index)[..., None]
    colours: NDArray[np.uint8] = np.round(RAMP[index] * (1.0 - fraction) + RAMP[index + 1] * fraction).astype(np.uint8)
    return colours


def linear_ticks(values: np.ndarray) -> NDArray[np.float64]:
    """The ticks of a linear scale from 0: at most nine round numbers."""
    top = float(np.percentile(values, _PERCENTILE)) if values.size else 0.0
    if not top > 0.0:
        return np.array([0.0, 1.0])
    step: float = 10.0 ** math.floor(math.log10(top / _MOST_TICKS))
    step *= next(k for k in (1, 2, 5, 10) if k * step * _MOST_TICKS >= top)
    ticks: np.ndarray = step * np.arange(math.ceil(top / step - _ROUNDING) + 1)
    return ticks


class Scale(NamedTuple):
    """The scale of a heat map's colours."""

    ticks: NDArray[np.float64]  # (k,), increasing, from the start of the scale to its end
    logarithmic: bool
    beyond: bool = False  # whether some values lie beyond the end

    def places(self, values: np.ndarray) -> NDArray[np.float64]:
        """(...) float64: positions on the scale: 0 at its start, 1 at its end, outside [0, 1] for values beyond it."""
        places: NDArray[np.float64]
        if not self.logarithmic:
            places = np.asarray(values, np.float64) / self.ticks[-1]
            return places
        with np.errstate(divide="ignore"):  # 0 lies infinitely far below the scale
            places = np.log(np.asarray(values, np.float64) / self.ticks[0]) / math.log(self.ticks[-1] / self.ticks[0])
        return places

    def colours(self, values: np.ndarray, known: NDArray[np.bool_]) -> NDArray[np.uint8]:
        """(..., 3) uint8: the colours of values; black where they are not `known`."""
        return np.where(known[..., None], heat_colours(self.places(values), 1.0), np.uint8(0))

    def bar(self, caption: str) -> ColourBar:
        """The colour bar; `caption` says what the values are."""
        texts = [f"{tick:,.6g}" for tick in self.ticks]
        texts = [("<" if self.logarithmic else "") + texts[0], *texts[1:-1], texts[-1] + "+" * self.beyond]
        return ColourBar(
            heat_colours(np.linspace(0.0, 1.0, 1024), 1.0), [*zip(self.places(self.ticks), texts)], caption
        )


def linear_scale(values: np.ndarray) -> Scale:
    """A linear scale from 0 that ignores a few extreme values."""
    ticks = linear_ticks(values)
    return Scale(ticks, False, _beyond(values, ticks))


def _beyond(values: np.ndarray, ticks: NDArray[np.float64]) -> bool:
    """Whether some values lie beyond the last tick."""
    return bool(values.size and values.max() > ticks[-1] * (1.0 + _ROUNDING))


def log_scale(values: np.ndarray) -> Scale:
    """A logarithmic scale with ticks at 1, 2 and 5 times powers of ten, which also begin and end it."""
    positive = np.asarray(values)[np.asarray(values) > 0.0]
    lower, upper = np.percentile(positive, (100.0 - _PERCENTILE, _PERCENTILE)) if positive.size else (1.0, 1.0)
    first, last = math.floor(math.log10(lower)), math.ceil(math.log10(upper))
    numbers = np.array([float(f"{k}e{e}") for e in range(first, last + 2) for k in (1, 2, 5)])
    begin = np.flatnonzero(numbers <= lower)[-1]
    end = max(np.flatnonzero(numbers >= upper)[0], begin + 1)
    ticks = numbers[begin : end + 1]
    return Scale(ticks, True, _beyond(positive, ticks))


def heat_map(
    panels: Sequence[np.ndarray], known: NDArray[np.bool_], labels: Sequence[Sequence[str]], caption: str
) -> NDArray[np.uint8]:
    """Draw panels of values side by side, each below its lines of text, with a colour bar at the bottom.

    Parameters
    ----------
    panels : (h, w) float each, 0 or more
    known : (h, w) bool
        Pixels with a value; others are black.
    labels : lines of text for each panel, the same number for all
    caption : str
        What the values are.

    Returns
    -------
    (H, W, 3) uint8 sRGB
    """
    scale = linear_scale(np.concatenate([panel[known] for panel in panels]))
    labelled_panels = [Panel(scale.colours(panel, known), lines) for panel, lines in zip(panels, labels)]
    return panel_sheet(labelled_panels, scale.bar(caption))
