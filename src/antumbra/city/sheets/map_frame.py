"""The frame of a map: its scale 1:N, its extent, coordinates along its edges, scale bar and arrow to north.

N is round, or given; lengths on the paper are exactly 1/N of those of the scene's coordinates in metres.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...scene.units import LengthUnit
from .page import FAINT, INK, Layout, Page, Rect, layout_of
from .page_text import text_width
from .sheet_options import PAPERS, Sheet
from .units_text import FOOT_UNITS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

METRIC = 1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.5
"""Times powers of ten: the round N of metric maps, as on scale rulers."""

FEET = 1.2, 2.4, 3.6, 4.8, 6.0, 7.2, 9.6
"""Times powers of ten: 1 inch is 10, 20, 30, 40, 50, 60 or 80 feet."""

_ROUND = 1e-9  # tolerance of a length that fits
_BAR = 45.0  # millimetres: longest scale bar
_COORDINATES = 30.0  # millimetres between coordinates, at least
_MM = 1000.0  # per metre


class Extent(NamedTuple):
    """The bounds of a map, in easting and northing."""

    west: float
    south: float
    east: float
    north: float

    @property
    def width(self) -> float:
        return self.east - self.west

    @property
    def height(self) -> float:
        return self.north - self.south

    def grown(self, margin: float) -> "Extent":
        """These bounds with a margin on all sides."""
        return Extent(self.west - margin, self.south - margin, self.east + margin, self.north + margin)

    def within(self, other: "Extent") -> "Extent":
        """The part of these bounds that is in others."""
        low = max(self.west, other.west), max(self.south, other.south)
        return Extent(*low, max(min(self.east, other.east), low[0]), max(min(self.north, other.north), low[1]))

    def meets(self, other: "Extent") -> bool:
        """Whether these bounds and others have a point in common."""
        across = self.west <= other.east and other.west <= self.east
        return across and self.south <= other.north and other.south <= self.north

    def text(self) -> str:
        """The bounds as the option --sheet takes them."""
        return ",".join(f"{round(value, 2):.12g}" for value in self)

    def joined(self, other: "Extent") -> "Extent":
        """The bounds of both."""
        west, south = min(self.west, other.west), min(self.south, other.south)
        return Extent(west, south, max(self.east, other.east), max(self.north, other.north))


def bounds_of(plan: NDArray[np.float64]) -> Extent:
    """The bounds of points, (n, 2) easting and northing; of none, an extent without area at the origin."""
    low, high = (plan.min(0), plan.max(0)) if len(plan) else (np.zeros(2), np.zeros(2))
    return Extent(*low.tolist(), *high.tolist())


# --- The scale --------------------------------------------------------------------------------------------------------


class MapFit(NamedTuple):
    """A map on a paper."""

    layout: Layout
    extent: Extent  # of the whole frame
    denominator: float  # N of 1:N

    def text(self, unit: LengthUnit) -> str:
        """The scale, such as "1:500", or "1:600 (1 in = 50 ft)"."""
        text = f"1:{self.denominator:,.6g}" if self.denominator < 1e6 else f"1:{self.denominator:,.0f}"
        feet = self.denominator / 12.0
        return f"{text} (1 in = {feet:,g} ft)" if unit.name in FOOT_UNITS and feet == round(feet) else text


def round_scale(least: float, unit: LengthUnit) -> float:
    """The smallest round N that is at least `least`; in feet, one at which an inch is a round number of feet."""
    series = FEET if unit.name in FOOT_UNITS else METRIC
    power = 10.0 ** np.floor(np.log10(least / series[0]))
    steps = [k * factor for factor in (power, 10.0 * power) for k in series]
    return float(next(round(n, 9) for n in steps if n >= least * (1.0 - _ROUND)))


def fit_map(extent: Extent, unit: LengthUnit, sheet: Sheet, margin: float = 2.0) -> MapFit:
    """Choose the orientation and the scale of a map.

    Parameters
    ----------
    extent : Extent
        What the map must show, in coordinates of the scene.
    unit : LengthUnit
        Of the coordinates.
    margin : float
        Millimetres to leave around it.

    Raises
    ------
    InputError
        If the map does not fit at the sheet's scale; the message has the scales at which it fits. Or if nothing of it
        lies in the sheet's extent.
    """
    if sheet.extent is not None:
        chosen = Extent(*sheet.extent)
        if not chosen.meets(extent):
            raise InputError(f"extent: nothing of the result lies in {chosen.text()}; it lies in {extent.text()}")
        extent, margin = chosen, 0.0
    least = {landscape: _least(extent, unit, layout_of(sheet.paper, landscape).map, margin)
             for landscape in _orientations(sheet)}  # fmt: skip
    landscape = min(least, key=least.__getitem__)
    layout, given = layout_of(sheet.paper, landscape), sheet.denominator
    denominator = round_scale(least[landscape], unit) if given is None else given
    if least[landscape] > denominator * (1.0 + _ROUND):
        raise InputError(_misfit(extent, unit, sheet, margin))
    half = np.array([layout.map.width, layout.map.height]) / 2.0 / _MM * denominator / unit.metres
    middle = np.array([extent.west + extent.east, extent.south + extent.north]) / 2.0
    return MapFit(layout, Extent(*(middle - half).tolist(), *(middle + half).tolist()), denominator)


def _orientations(sheet: Sheet) -> tuple[bool, ...]:
    return (True, False) if sheet.orientation == "auto" else (sheet.orientation == "landscape",)


def _least(extent: Extent, unit: LengthUnit, frame: Rect, margin: float) -> float:
    """The least N at which an extent fits into a frame."""
    across = extent.width / (frame.width - 2.0 * margin), extent.height / (frame.height - 2.0 * margin)
    return max(*across, 1e-12) * unit.metres * _MM


def _misfit(extent: Extent, unit: LengthUnit, sheet: Sheet, margin: float) -> str:
    """Why a scale is impossible, and which ones are possible."""

    def fits(paper: str) -> float:
        frames = [layout_of(paper, landscape).map for landscape in _orientations(sheet)]
        return round_scale(min(_least(extent, unit, frame, margin) for frame in frames), unit)

    size = f"{extent.width:,.5g} x {extent.height:,.5g} {unit.name}"
    here = f"1:{fits(sheet.paper):,.6g}"
    larger = next((name for name, area in PAPERS.items() if max(area) > 1.3 * max(PAPERS[sheet.paper])), None)
    if sheet.paper == "letter":
        larger = "tabloid"
    other = "" if larger is None else f", or {larger.title()}, where 1:{fits(larger):,.6g} fits"
    wanted = f"1:{sheet.denominator:,.6g} does not fit on {sheet.paper.title()}"
    return f"scale: {wanted}; the extent of {size} needs {here}{other}"


# --- Drawing ----------------------------------------------------------------------------------------------------------


def draw_frame(page: Page, axes: "Axes", fit: MapFit, unit: LengthUnit, north: float, is_true: bool) -> None:
    """Limit a map to its extent, and draw its border, coordinates, scale bar and the arrow to north.

    north : degrees, true north clockwise from that of the coordinates
    is_true : whether it is known
    """
    extent, frame = fit.extent, fit.layout.map
    axes.set(xlim=(extent.west, extent.east), ylim=(extent.south, extent.north), xticks=[], yticks=[])
    axes.set_aspect("auto")
    axes.set_facecolor("white")
    for spine in axes.spines.values():
        spine.set(color=INK, linewidth=0.6)
    for value, at in _coordinates(extent.west, extent.width, frame.width):
        x = frame.left + at
        page.line((x, x), (frame.bottom, frame.bottom - 1.2), INK)
        page.text(x, frame.bottom - 3.8, value, 6, ha="center", color=FAINT)
    for value, at in _coordinates(extent.south, extent.height, frame.height):
        y = frame.bottom + at
        page.line((frame.left - 1.2, frame.left), (y, y), INK)
        page.text(frame.left - 2.0, y, value, 6, rotation=90, ha="right", va="center", color=FAINT)
    _draw_scale_bar(page, fit, unit)
    _draw_north(page, frame, north, is_true)


def _coordinates(low: float, span: float, length: float) -> Iterator[tuple[str, float]]:
    """Yield round coordinates, and their places along an edge of a map: both as text and in millimetres."""
    step = round_length(4.0 * span * _COORDINATES / length)
    step = step if step >= span * _COORDINATES / length else 2.0 * step
    first = int(np.ceil(low / step))
    for k in range(first, int(np.floor((low + span) / step)) + 1):
        at = (k * step - low) / span * length
        text = f"{k * step:.10g}"
        half = text_width(text, 6) / 2.0
        if half < at < length - half:
            yield text, at


def round_length(width: float) -> float:
    """1, 2 or 5 times a power of ten, at most a quarter of a width."""
    power = 10.0 ** np.floor(np.log10(width / 4.0))
    return float(power * max(k for k in (1, 2, 5) if k * power <= width / 4.0 * (1.0 + 1e-12)))


def _draw_scale_bar(page: Page, fit: MapFit, unit: LengthUnit) -> None:
    """Draw a bar below the map, in the unit of its coordinates, and the scale beside it."""
    frame = fit.layout.map
    per_unit = unit.metres * _MM / fit.denominator  # millimetres on the paper
    length = round_length(4.0 * min(_BAR, frame.width / 3.0) / per_unit)
    bar = Rect(frame.left, frame.bottom - 8.2, length * per_unit, 1.6)
    half = bar._replace(width=bar.width / 2.0)
    page.box(half, INK, INK)
    page.box(half._replace(left=half.right), "white", INK)
    in_km = unit.name == "m" and length >= 1000.0
    factor, name = (1e-3, "km") if in_km else (1.0, unit.name)
    for share in (0.0, 0.5, 1.0):
        text = f"{length * share * factor:.10g}" + (f" {name}" if share == 1.0 else "")
        number = text_width(text.removesuffix(f" {name}"), 7)
        x = bar.left + share * bar.width - (0.0 if share == 0.0 else number / 2.0)
        page.text(x, bar.bottom - 3.2, text, 7)
    page.text(frame.right, bar.bottom - 0.4, f"Scale {fit.text(unit)}", 9, ha="right", weight="bold")


def _draw_north(page: Page, frame: Rect, north: float, is_true: bool) -> None:
    """Draw an arrow in the corner of the map, to true north, or to that of the coordinates if no place is known."""
    radius = 6.0
    axes: Any = page.axes(Rect(frame.right - 2.0 * radius - 1.5, frame.top - 2.0 * radius - 1.5, 12.0, 12.0), zorder=9)
    axes.set(xlim=(-1.5, 1.5), ylim=(-1.5, 1.5), xticks=[], yticks=[])
    axes.patch.set(facecolor="white", alpha=0.85)
    for spine in axes.spines.values():
        spine.set(color=FAINT, linewidth=0.4)
    angle = np.radians(north)
    ahead = np.array([np.sin(angle), np.cos(angle)])
    side = np.array([ahead[1], -ahead[0]])
    tip, back = 0.75 * ahead, -1.1 * ahead
    shift = -0.15 * ahead if is_true else 0.1 * ahead
    for sign, colour in ((1.0, INK), (-1.0, "white")):
        corners = np.array([tip, back + sign * 0.45 * side, back + 0.3 * ahead]) + shift
        axes.fill(*corners.T, facecolor=colour, edgecolor=INK, linewidth=0.5)
    place = dict(ha="center", va="center", fontsize=7, color=INK, weight="bold")
    axes.text(*(1.1 * ahead + shift).tolist(), "N", **place)
    if not is_true:
        axes.text(0.0, -1.42, "grid", ha="center", va="bottom", fontsize=5, color=FAINT)
