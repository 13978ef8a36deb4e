"""Heat maps: numbers of pixels as colours, in panels side by side, with one scale for all and a colour bar."""

import math
from collections.abc import Sequence

import numpy as np

# The colour map `plasma` of Nathaniel Smith and Stefan van der Walt (CC0), in sRGB. It is perceptually uniform. Its
# lowest colour differs from the black of pixels without a number.
_RAMP = np.array([
    [13, 8, 135], [49, 5, 151], [76, 2, 161], [102, 0, 167], [126, 3, 168], [149, 17, 161], [170, 35, 149],
    [188, 53, 135], [204, 71, 120], [218, 90, 106], [230, 108, 92], [240, 128, 78], [248, 149, 64], [253, 172, 51],
    [253, 197, 39], [248, 223, 37], [240, 249, 33],
], np.float64)  # fmt: skip
_PERCENTILE = 99.5  # of the numbers, where the scale ends, so that a few pixels do not make all others dark
_MOST_TICKS = 8
_PAPER, _INK, _FAINT = (30, 30, 34), (236, 236, 236), (160, 160, 166)
_NARROWEST = 240  # least width for a panel's labels, in pixels
_SMALLEST, _LARGEST = 7, 22  # font sizes, in pixels


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
    return step * np.arange(math.ceil(top / step) + 1)


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
    from PIL import Image, ImageDraw

    h, w = known.shape
    ticks = scale_of(np.concatenate([panel[known] for panel in panels]))
    letters = min(max(w // 24, 13), _LARGEST)
    line, gap, cell = round(1.4 * letters), letters, max(w, _NARROWEST)
    above, bar = gap // 2 + line * len(labels[0]) + gap // 4, letters
    width, below = gap + len(panels) * (cell + gap), gap // 2 + line + bar + line
    image = Image.new("RGB", (width, above + h + below + gap // 2), _PAPER)
    draw = ImageDraw.Draw(image)
    for i, (panel, lines) in enumerate(zip(panels, labels)):
        x = gap + i * (cell + gap)
        for k, text in enumerate(lines):
            _write(draw, (x, gap // 2 + k * line), text, letters, cell, _FAINT if k else _INK)
        colours = np.where(known[..., None], heat_colours(panel, ticks[-1]), np.uint8(0))
        image.paste(Image.fromarray(colours), (x, above))
    y, length = above + h + gap // 2, width - 2 * gap
    _write(draw, (gap, y), caption, letters, length, _INK)
    scale = heat_colours(np.broadcast_to(np.linspace(0.0, 1.0, length), (bar, length)), 1.0)
    image.paste(Image.fromarray(scale), (gap, y + line))
    _write_ticks(draw, ticks, gap, y + line + bar, length, letters)
    return np.asarray(image)


def _write_ticks(draw, ticks: np.ndarray, x: int, y: int, length: int, letters: int) -> None:
    """Draw the numbers under a bar: as many as have room."""
    font = _font(letters)
    texts = [f"{tick:,.6g}" for tick in ticks]
    texts[-1] += "+"
    room = 1.5 * max(font.getlength(text) for text in texts) + letters / 2  # the first and last are moved inwards
    last = len(ticks) - 1
    every = next((k for k in range(1, last) if last % k == 0 and k * length / last >= room), last)
    for i in range(0, last + 1, every):
        at = length * i / last
        left = min(max(at - font.getlength(texts[i]) / 2, 0), length - font.getlength(texts[i]))
        draw.text((x + left, y + letters // 6), texts[i], _FAINT, font)


def _write(draw, at: tuple[int, int], text: str, letters: int, width: int, colour) -> None:
    """Draw a line of text in the largest font size, up to `letters` pixels, that fits into `width`."""
    while letters > _SMALLEST and _font(letters).getlength(text) > width:
        letters -= 1
    draw.text(at, text, colour, _font(letters))


def _font(letters: int):
    from PIL import ImageFont

    return ImageFont.load_default(letters)
