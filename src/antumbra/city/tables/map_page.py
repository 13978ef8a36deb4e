"""Pages of A4 for reports: a picture with its heading, scale bar and north arrow, and a column of keys and facts.

`map_sheet`, `shadow` and `skyline` draw their results on them. The same content gives the same bytes.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.files import atomic_output, checked_output
from ...scene.units import METRE
from ...version import VERSION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAP_SUFFIXES = (".pdf", ".png", ".svg")
"""Suffixes of map sheets."""

PAGE = (11.69, 8.27)
"""Inches: A4, landscape."""

PICTURE = (0.04, 0.05, 0.62, 0.84)
"""Left, bottom, width and height of the picture on the page."""

COLUMN = 0.70
"""Left edge of the column of keys and facts."""

TOP = 0.82
"""Height of the first key."""

DPI = 200
"""Of .png, and of the cells in .pdf and .svg."""

INK, FAINT = "#202124", "#6b6f76"
"""Colours of text and lines."""

_LETTERS = 40  # in a line of facts
_LINE = 0.026  # height of a line, in pages
_SEED = "antumbra"  # of the ids in .svg


def check_map(path: str | os.PathLike[str]) -> Path:
    """The path of a map sheet, checked before long work: its suffix, and that matplotlib is installed.

    Raises
    ------
    InputError
        If the suffix is unknown, the path cannot be written, or matplotlib is missing.
    """
    target = checked_output(path, MAP_SUFFIXES)
    import_extra("matplotlib", "a map sheet", "plot")
    return target


def save_page(path: Path, draw: Callable[[], "Figure"]) -> None:
    """Write the page that a function draws."""
    from matplotlib import rc_context

    suffix = path.suffix.lower()
    dates: dict[str, dict[str, Any]] = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}, ".png": {}}
    with rc_context({"svg.hashsalt": _SEED, "svg.fonttype": "none", "pdf.fonttype": 42, "font.family": "DejaVu Sans"}):
        figure = draw()
        with atomic_output(path) as temporary, open(temporary, "wb") as file:
            figure.savefig(file, format=suffix[1:], dpi=DPI, metadata=dates[suffix])


def new_page(heading: str) -> "Figure":
    """A page with a heading."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=PAGE, facecolor="white")
    figure.text(PICTURE[0], 0.93, heading, fontsize=17, color=INK, weight="bold", va="bottom")
    return figure


# --- Maps -------------------------------------------------------------------------------------------------------------


class Extent(NamedTuple):
    """The bounds of a map, in easting and northing."""

    west: float
    south: float
    east: float
    north: float

    @property
    def width(self) -> float:
        return self.east - self.west


def framed(plan: NDArray[np.float64]) -> Extent:
    """The bounds of points, with a margin."""
    low, high = (plan.min(0), plan.max(0)) if len(plan) else (np.zeros(2), np.ones(2))
    margin = 0.03 * float((high - low).max()) or 1.0
    return Extent(*(low - margin).tolist(), *(high + margin).tolist())


def draw_frame(figure: "Figure", axes: "Axes", extent: Extent, about: dict[str, Any]) -> None:
    """Limit a map to its bounds, and draw its border, its scale bar and the arrow to north."""
    axes.set(xlim=(extent.west, extent.east), ylim=(extent.south, extent.north), xticks=[], yticks=[])
    axes.set_aspect("equal", adjustable="box", anchor="C")
    axes.set_facecolor("white")
    for spine in axes.spines.values():
        spine.set(color=FAINT, linewidth=0.6)
    _draw_scale_bar(axes, extent, str(about.get("length_unit", METRE.name)))
    _draw_north(figure, float(about.get("north", 0.0)), "latitude" in about)


def round_length(width: float) -> float:
    """The length of a scale bar: 1, 2 or 5 times a power of ten, at most a quarter of a map's width."""
    power = 10.0 ** np.floor(np.log10(width / 4.0))
    return float(power * max(k for k in (1, 2, 5) if k * power <= width / 4.0 * (1.0 + 1e-12)))


def _draw_scale_bar(axes: "Axes", extent: Extent, unit: str) -> None:
    """Draw a bar below the map, from its west edge, with its length in the unit of the map."""
    length = round_length(extent.width)
    share = length / extent.width
    style: dict[str, Any] = {"transform": axes.transAxes, "clip_on": False, "solid_capstyle": "butt"}
    axes.plot([0.0, share], [-0.025, -0.025], color=INK, linewidth=3, **style)
    axes.plot([share / 2.0, share], [-0.025, -0.025], color="white", linewidth=1.6, **style)
    in_km = unit == METRE.name and length >= 1000.0
    text = f"{length / 1000.0:g} km" if in_km else f"{length:.10g} {unit}"
    axes.text(share + 0.012, -0.025, text, transform=axes.transAxes, va="center", fontsize=9, color=INK)


def _draw_north(figure: "Figure", north: float, is_true: bool) -> None:
    """Draw an arrow to true north, or to the north of the coordinates if no place is known."""
    axes = figure.add_axes((0.905, 0.87, 0.07, 0.10))
    axes.set(xlim=(-1.3, 1.3), ylim=(-1.3, 1.3), xticks=[], yticks=[], aspect="equal")
    axes.axis("off")
    angle = np.radians(north)
    east, up = float(np.sin(angle)), float(np.cos(angle))
    arrow = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.6}
    axes.annotate("", (0.75 * east, 0.75 * up), (-0.75 * east, -0.75 * up), arrowprops=arrow)
    axes.text(1.1 * east, 1.1 * up, "N", ha="center", va="center", fontsize=11, weight="bold", color=INK)
    if not is_true:
        axes.text(0.0, -1.25, "grid", ha="center", va="top", fontsize=7, color=FAINT)


# --- The column of keys and facts -------------------------------------------------------------------------------------


def draw_caption(figure: "Figure", text: str) -> None:
    """Draw the caption above the keys."""
    figure.text(COLUMN, 0.845, text, fontsize=11, weight="bold", color=INK)


def draw_key(figure: "Figure", colour: Any, text: str, top: float) -> float:
    """Draw a colour and its meaning, and return the height of the next row."""
    from matplotlib.patches import Rectangle

    box = Rectangle((COLUMN, top - 0.018), 0.028, 0.022, facecolor=colour, edgecolor=FAINT, linewidth=0.4)
    box.set_transform(figure.transFigure)
    figure.add_artist(box)
    figure.text(COLUMN + 0.038, top - 0.007, text, fontsize=10, va="center", color=INK)
    return top - 0.036


def draw_facts(figure: "Figure", facts: Iterable[tuple[str, str]], top: float) -> None:
    """Draw the facts below the legend, as many as fit."""
    for name, text in facts:
        lines = wrap(text, _LETTERS) or [""]
        if top - _LINE * (len(lines) + 1) < 0.06:
            return
        figure.text(COLUMN, top - _LINE, name, fontsize=8, color=FAINT, va="bottom")
        for k, line in enumerate(lines):
            figure.text(COLUMN, top - _LINE * (k + 1.9), line, fontsize=9, color=INK, va="bottom")
        top -= _LINE * (len(lines) + 1.35)
    figure.text(COLUMN, 0.025, f"Antumbra {VERSION}", fontsize=7, color=FAINT)


def place_facts(about: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield names and texts of the place, the vegetation and the CRS in the metadata of a study."""
    if "latitude" in about:
        zone = about.get("timezone") or "solar zone"
        yield "place", f"{about['latitude']:.5f}, {about['longitude']:.5f} (WGS 84); {zone}"
    if about.get("trees"):
        yield "trees", str(about["trees"])
    if about.get("crs"):
        yield "reference system", str(about["crs"])


def minutes_text(text: str) -> str:
    """A time without its seconds."""
    return str(text).replace("T", " ")[:16]


def checked_title(title: str | None) -> str | None:
    """A title of one line; otherwise an InputError."""
    if title is not None and (not isinstance(title, str) or "\n" in title or not title.strip()):
        raise InputError(f"title is {title!r}; give one line of text, or leave it out")
    return title
