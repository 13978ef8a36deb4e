"""Texts on a page, in millimetres: their widths, their lines, and the size at which they fit.

Widths are those of the font, without a renderer, so that the layout of a page is the same in PDF, SVG and PNG.
"""

from functools import lru_cache

from ...base.errors import InputError

FONT = "DejaVu Sans"
"""The font of all texts: matplotlib comes with it."""

MM_PER_POINT = 25.4 / 72.0

LINE = 1.35
"""Distance of lines, in font sizes."""


@lru_cache(maxsize=1 << 16)
def text_width(text: str, size: float, bold: bool = False) -> float:
    """The width of a line in millimetres; `size`: in points."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(family=FONT, size=size, weight="bold" if bold else "normal")
    width, _, _ = text_to_path.get_text_width_height_descent(text, font, ismath=False)
    return float(width) * MM_PER_POINT


def line_height(size: float) -> float:
    """The distance of lines in millimetres."""
    return LINE * size * MM_PER_POINT


def wrapped(text: str, size: float, width: float, bold: bool = False) -> list[str]:
    """The lines of a text, each at most `width` millimetres wide. Words that are wider are divided."""
    lines, line = list[str](), ""
    for word in text.split():
        joined = f"{line} {word}" if line else word
        if text_width(joined, size, bold) <= width:
            line = joined
            continue
        if line:
            lines.append(line)
        while text_width(word, size, bold) > width and len(word) > 1:
            count = max(int(len(word) * width / text_width(word, size, bold)), 1)
            while count > 1 and text_width(word[:count], size, bold) > width:
                count -= 1
            lines.append(word[:count])
            word = word[count:]
        line = word
    return [*lines, line] if line or not lines else lines


def fitted(text: str, width: float, sizes: tuple[float, ...], bold: bool = False) -> float:
    """The largest of `sizes`, in descending order, at which a line fits; the last one if none does."""
    return next((size for size in sizes if text_width(text, size, bold) <= width), sizes[-1])


def fitted_lines(
    text: str, what: str, width: float, sizes: tuple[tuple[float, int], ...], bold: bool = False
) -> tuple[float, list[str]]:
    """The first of `sizes`, pairs of a font size and a number of lines, at which a text fits; and its lines.

    Raises
    ------
    InputError
        If it fits at none of them.
    """
    for size, most in sizes:
        lines = wrapped(text, size, width, bold)
        if len(lines) <= most:
            return size, lines
    raise InputError(f"{what} of {len(text)} characters does not fit on the sheet; shorten it: {text[:40]}...")
