"""The colour scale of a map: classes for yes and no, otherwise a scale that ends at the true extremes of the values.

Losses have a scale with two hues that is centred on zero. Map sheets and QGIS styles share all scales, so that a colour
means the same number in both. They differ in lightness, too, so that maps can be read in print without colours, and by
readers who do not see red and green.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...picture.heat_maps import heat_colours

_STEPS = 16  # colours between which QGIS interpolates
_LEAST_SPAN = 1e-300  # below, powers of ten lose their digits
_MOST_TICKS = 6
_APART = 0.6  # tick steps: a round number closer to an end of the scale is left out
_YES_NO = (190, 190, 196), (33, 120, 110)  # sRGB
_FAILS_PASSES = (176, 58, 26), (158, 202, 225)
_LOSS = np.array([[247, 246, 244], [253, 184, 99], [217, 108, 28], [127, 52, 6]], np.float64)  # from 0 up
_GAIN = np.array([[247, 246, 244], [170, 205, 230], [90, 155, 205]], np.float64)  # from 0 down; lighter than losses
_VERDICT, _CHANGE = "passes", "_loss"
_NAMES = {_VERDICT: ("fails", "passes"), "visible": ("not visible", "visible"), "seen": ("not visible", "visible")}


class MapClass(NamedTuple):
    """A value with a name."""

    value: float
    name: str
    colour: tuple[int, int, int]  # sRGB


class MapScale(NamedTuple):
    """A scale from `low` to `high`, or classes."""

    low: float  # 0, or the least value if that is negative
    high: float  # the greatest value
    classes: tuple[MapClass, ...]  # of booleans and ranges, by ascending value; () for numbers
    whole: bool  # whether values are whole numbers
    unit: str
    class_type: str = "double"  # of the values of classes, as QGIS names it
    diverging: bool = False  # whether equal colours on both sides of 0 are equally far from it

    def colours(self, values: NDArray[np.float64]) -> NDArray[np.uint8]:
        """(..., 3) uint8 sRGB of known values."""
        if self.classes:
            table = np.array([each.colour for each in self.classes], np.uint8)
            return np.asarray(table[np.searchsorted([each.value for each in self.classes], values)])
        if self.diverging:
            return _change_colours(values / (max(-self.low, self.high) or 1.0))
        return heat_colours((values - self.low) / (self.span or 1.0), 1.0)

    @property
    def span(self) -> float:
        """The length of the scale; 0 if all values are the same."""
        return self.high - self.low

    def stops(self) -> list[MapClass]:
        """The classes; or values at equal steps of the scale, from its start to its end, with their texts."""
        if self.classes:
            return list(self.classes)
        shares = np.linspace(0.0, 1.0, _STEPS + 1) if self.span else np.zeros(1)
        values = [self.low + share * self.span for share in shares.tolist()]
        values[-1] = self.high
        if self.diverging:
            values = sorted({*values, 0.0})  # neutral, also between two steps
        colours = self.colours(np.array(values))
        return [MapClass(v, self.text(v), tuple(c)) for v, c in zip(values, colours.tolist())]

    def ticks(self) -> list[float]:
        """The start and the end of the scale, and round numbers between them."""
        if not self.span:
            return [self.low]
        if self.span < _LEAST_SPAN:
            return [self.low, self.high]
        step = 10.0 ** math.floor(math.log10(self.span / _MOST_TICKS))
        step *= next(k for k in (1, 2, 5, 10) if k * step * _MOST_TICKS >= self.span * (1.0 - 1e-12))
        step = max(step, 1.0) if self.whole else step
        first, last = math.ceil(self.low / step), math.floor(self.high / step)
        inner = [k * step for k in range(first, last + 1)]
        clear = [x for x in inner if self.low + _APART * step < x < self.high - _APART * step]
        return [self.low, *clear, self.high]

    def text(self, value: float) -> str:
        """A value with its unit."""
        number = f"{value:,.4g}" if abs(value) < 1000.0 else f"{value:,.0f}"
        return f"{number} {self.unit}" if self.unit else number


def map_scale(
    values: np.ndarray, known: NDArray[np.bool_], unit: str = "", name: str = "", *, yes_or_no: bool = False
) -> MapScale:
    """The scale of a column.

    known : (n,) bool: the values that count
    name : of the column; one that ends in ``passes`` or ``passes_before`` holds verdicts, and in ``_loss`` losses
    yes_or_no : whether whole numbers are 0 or 1, for no and yes
    """
    if values.dtype.kind == "b" or yes_or_no:
        now = name.removesuffix("_before")
        verdict = now.endswith(_VERDICT)
        names = _NAMES.get(_VERDICT if verdict else now, ("no", "yes"))
        colours = _FAILS_PASSES if verdict else _YES_NO
        classes = tuple(MapClass(float(k), names[k], colours[k]) for k in (0, 1))
        return MapScale(0.0, 1.0, classes, True, "", "bool" if values.dtype.kind == "b" else "integer")
    chosen = values[known].astype(np.float64)
    low, high = (float(chosen.min()), float(chosen.max())) if len(chosen) else (0.0, 0.0)
    whole, diverging = values.dtype.kind in "iu", name.endswith(_CHANGE)
    return MapScale(min(low, 0.0), max(high, 0.0), (), whole, unit, diverging=diverging)


def _change_colours(shares: NDArray[np.float64]) -> NDArray[np.uint8]:
    """(..., 3) uint8: the colours of losses, from -1 (the greatest gain) over 0 to 1 (the greatest loss)."""
    share = np.abs(np.clip(shares, -1.0, 1.0))[..., None]
    ramps = (np.stack([np.interp(share[..., 0], np.linspace(0.0, 1.0, len(ramp)), ramp[:, k]) for k in range(3)], -1)
             for ramp in (_LOSS, _GAIN))  # fmt: skip
    loss, gain = ramps
    return np.round(np.where(shares[..., None] < 0.0, gain, loss)).astype(np.uint8)


def range_scale(lower: np.ndarray, upper: np.ndarray, unit: str) -> MapScale:
    """The scale of ranges, classes that their lower ends identify: "2 to 4 h"."""
    ends = dict(sorted(zip(lower.tolist(), upper.tolist())))
    high = max(ends.values(), default=0.0)
    colours = heat_colours(np.array(list(ends)) / (high or 1.0), 1.0).tolist()
    names = [f"{low:g} to {high:g} {unit}" for low, high in ends.items()]
    classes = [MapClass(low, name, tuple(colour)) for low, name, colour in zip(ends, names, colours)]
    return MapScale(min(ends, default=0.0), high, tuple(classes), False, unit)
