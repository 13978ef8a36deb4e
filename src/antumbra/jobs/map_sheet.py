"""Map sheets for reports: a map with its scale bar, north arrow and legend, and a column of facts, on a page of A4.

The legend ends at the true extremes of the values. Continuous quantities are interpolated between the centres of the
cells of a raster; whole numbers and classes are drawn as cells. The same table gives the same bytes.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..extras import import_extra
from ..files import atomic_output, checked_output
from ..version import VERSION
from .false_colours import column_values
from .map_scale import MapScale, map_scale

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAP_SUFFIXES = (".pdf", ".png", ".svg")
"""Suffixes of map sheets."""

_PAGE = (11.69, 8.27)  # inches: A4, landscape
_MAP = (0.04, 0.05, 0.62, 0.84)  # left, bottom, width and height of the map on the page
_FACTS = 0.70  # left edge of the column of facts
_DPI = 200  # of .png, and of the cells in .pdf and .svg
_LETTERS = 40  # in a line of facts
_LINE = 0.026  # height of a line, in pages
_MOST_AREAS = 12
_INK, _FAINT, _NOWHERE = "#202124", "#6b6f76", "#d9d9dc"
_SEED = "antumbra"  # of the ids in .svg


class _Extent(NamedTuple):
    """The bounds of a map, in easting and northing."""

    west: float
    south: float
    east: float
    north: float

    @property
    def width(self) -> float:
        return self.east - self.west


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


def save_map(table: Any, path: Path, column: str, title: str | None = None) -> None:
    """Write the map sheet of a column of a `Table`."""
    from matplotlib import rc_context

    suffix = path.suffix.lower()
    dates: dict[str, dict[str, Any]] = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}, ".png": {}}
    with rc_context({"svg.hashsalt": _SEED, "svg.fonttype": "none", "pdf.fonttype": 42, "font.family": "DejaVu Sans"}):
        figure = map_figure(table, column, title)
        with atomic_output(path) as temporary, open(temporary, "wb") as file:
            figure.savefig(file, format=suffix[1:], dpi=_DPI, metadata=dates[suffix])


def map_figure(table: Any, column: str, title: str | None = None) -> "Figure":
    """The sheet as a figure of matplotlib."""
    from matplotlib.figure import Figure

    values, known = column_values(table, column)
    chosen = table.columns[column]
    scale = map_scale(chosen.values, known, chosen.unit)
    figure = Figure(figsize=_PAGE, facecolor="white")
    axes = figure.add_axes(_MAP)
    extent = _draw_values(axes, table, np.where(known, values, np.nan), scale)
    _draw_marks(axes, table)
    axes.set(xlim=(extent.west, extent.east), ylim=(extent.south, extent.north), xticks=[], yticks=[])
    axes.set_aspect("equal", adjustable="box", anchor="C")
    axes.set_facecolor("white")
    for spine in axes.spines.values():
        spine.set(color=_FAINT, linewidth=0.6)
    _draw_scale_bar(axes, extent)
    _draw_north(figure, float(table.about.get("north", 0.0)), "latitude" in table.about)
    heading = title or chosen.about[:1].upper() + chosen.about[1:] or column
    figure.text(_MAP[0], 0.93, heading, fontsize=17, color=_INK, weight="bold", va="bottom")
    top = _draw_legend(figure, scale, values[known], f"{column} [{chosen.unit}]" if chosen.unit else column)
    if not known.all():
        top = _draw_key(figure, _NOWHERE, "no value", top)
    _draw_facts(figure, table, top)
    return figure


# --- The map ----------------------------------------------------------------------------------------------------------


def plan_positions(table: Any, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) float64: easting and northing of world points."""
    y_up = table.scene is not None and table.scene.up == "y"
    return np.stack([points[:, 0], -points[:, 2]], 1) if y_up else points[:, :2]


def _draw_values(axes: "Axes", table: Any, values: np.ndarray, scale: MapScale) -> _Extent:
    """Draw the values, NaN in grey, and return the bounds of the map."""
    raster = table.sensors.raster
    if raster is not None:
        east, south = raster.west + raster.columns * raster.spacing, raster.north - raster.rows * raster.spacing
        extent = _Extent(raster.west, south, east, raster.north)
        cells = table.sensors.on_raster(values)
        axes.imshow(_pixels(cells, scale), extent=(extent.west, east, south, extent.north), interpolation="nearest")
        return extent
    faces = table.sensors.kind == "face" and table.scene is not None
    return (_draw_faces if faces else _draw_points)(axes, table, values, scale)


def _pixels(cells: NDArray[np.float64], scale: MapScale) -> NDArray[np.uint8]:
    """(h, w, 4) uint8: the cells of a raster; a continuous quantity is interpolated."""
    if not (scale.classes or scale.whole):
        cells = smooth_cells(cells, max(1, int(_DPI * _PAGE[0] * _MAP[2]) // max(cells.shape)))
    known = np.isfinite(cells)
    colours = np.full((*cells.shape, 4), 255, np.uint8)
    colours[..., :3] = scale.colours(np.where(known, cells, scale.low))
    colours[~known] = tuple(int(_NOWHERE[k : k + 2], 16) for k in (1, 3, 5)) + (255,)
    return colours


def smooth_cells(cells: NDArray[np.float64], parts: int) -> NDArray[np.float64]:
    """(h * parts, w * parts) float64: cells divided into parts, with bilinear interpolation between their centres.

    A part of a cell without a value has none, and others ignore cells without a value, so the outlines of holes stay.
    Values stay between those of the cells.
    """
    known = np.isfinite(cells)
    weights, values = known.astype(np.float64), np.where(known, cells, 0.0)
    for axis in 0, 1:
        weights, values = (_stretched(each, parts, axis) for each in (weights, values))
    with np.errstate(invalid="ignore"):
        smooth = values / weights
    smooth = np.clip(smooth, np.nanmin(cells), np.nanmax(cells)) if known.any() else smooth
    return np.where(known.repeat(parts, 0).repeat(parts, 1), smooth, np.nan)


def _stretched(values: NDArray[np.float64], parts: int, axis: int) -> NDArray[np.float64]:
    """Linear interpolation at the centres of the parts of cells along an axis; constant beyond the outermost ones."""
    n = values.shape[axis]
    at = np.clip((np.arange(n * parts) + 0.5) / parts - 0.5, 0.0, n - 1.0)
    low = np.minimum(at.astype(np.int64), max(n - 2, 0))
    share = np.expand_dims(at - low, 1 - axis)
    first, second = values.take(low, axis), values.take(np.minimum(low + 1, n - 1), axis)
    return np.asarray(first * (1.0 - share) + second * share)


def _hex_colours(values: np.ndarray, scale: MapScale) -> NDArray[np.float64]:
    """(n, 3) float64 sRGB in [0, 1] of values, grey for NaN."""
    known = np.isfinite(values)
    grey = [int(_NOWHERE[k : k + 2], 16) for k in (1, 3, 5)]
    return np.where(known[:, None], scale.colours(np.where(known, values, scale.low)), grey) / 255.0


def _draw_faces(axes: "Axes", table: Any, values: np.ndarray, scale: MapScale) -> _Extent:
    """Draw faces from above, the highest last."""
    from matplotlib.collections import PolyCollection

    from .sensors import corners_of

    corners = corners_of(table.scene)[table.sensors.faces]
    up = "xyz".index(table.scene.up)
    order = np.argsort(corners[..., up].max(1), kind="stable")
    plan = plan_positions(table, corners.reshape(-1, 3)).reshape(-1, 3, 2)[order]
    colours = _hex_colours(values[order], scale)
    axes.add_collection(PolyCollection(list(plan), facecolors=colours, edgecolors=colours, linewidths=0.2))
    return _framed(plan.reshape(-1, 2))


def _draw_points(axes: "Axes", table: Any, values: np.ndarray, scale: MapScale) -> _Extent:
    """Draw a dot per sensor, the highest last."""
    sensors = table.sensors
    up = "xyz".index("z" if table.scene is None else table.scene.up)
    order = np.argsort(sensors.points[:, up], kind="stable")
    plan = plan_positions(table, sensors.points)[order]
    size = float(np.clip(60_000.0 / max(len(plan), 1), 2.0, 60.0))
    axes.scatter(plan[:, 0], plan[:, 1], s=size, c=_hex_colours(values[order], scale), linewidths=0.0)
    return _framed(plan)


def _framed(plan: NDArray[np.float64]) -> _Extent:
    """The bounds of points, with a margin."""
    low, high = (plan.min(0), plan.max(0)) if len(plan) else (np.zeros(2), np.ones(2))
    margin = 0.03 * float((high - low).max()) or 1.0
    return _Extent(*(low - margin).tolist(), *(high + margin).tolist())


def _draw_marks(axes: "Axes", table: Any) -> None:
    if table.marks is not None and len(table.marks):
        plan = plan_positions(table, table.marks)
        axes.scatter(plan[:, 0], plan[:, 1], s=36, c="white", edgecolors="black", linewidths=1.2, zorder=5)


def round_length(width: float) -> float:
    """The length of a scale bar: 1, 2 or 5 times a power of ten, at most a quarter of a map's width."""
    power = 10.0 ** np.floor(np.log10(width / 4.0))
    return float(power * max(k for k in (1, 2, 5) if k * power <= width / 4.0 * (1.0 + 1e-12)))


def _draw_scale_bar(axes: "Axes", extent: _Extent) -> None:
    """Draw a bar below the map, from its west edge."""
    length = round_length(extent.width)
    share = length / extent.width
    style: dict[str, Any] = {"transform": axes.transAxes, "clip_on": False, "solid_capstyle": "butt"}
    axes.plot([0.0, share], [-0.025, -0.025], color=_INK, linewidth=3, **style)
    axes.plot([share / 2.0, share], [-0.025, -0.025], color="white", linewidth=1.6, **style)
    text = f"{length / 1000.0:g} km" if length >= 1000.0 else f"{length:g} m"
    axes.text(share + 0.012, -0.025, text, transform=axes.transAxes, va="center", fontsize=9, color=_INK)


def _draw_north(figure: "Figure", north: float, is_true: bool) -> None:
    """Draw an arrow to true north, or to the north of the coordinates if no place is known."""
    axes = figure.add_axes((0.905, 0.87, 0.07, 0.10))
    axes.set(xlim=(-1.3, 1.3), ylim=(-1.3, 1.3), xticks=[], yticks=[], aspect="equal")
    axes.axis("off")
    angle = np.radians(north)
    east, up = float(np.sin(angle)), float(np.cos(angle))
    arrow = {"arrowstyle": "-|>", "color": _INK, "linewidth": 1.6}
    axes.annotate("", (0.75 * east, 0.75 * up), (-0.75 * east, -0.75 * up), arrowprops=arrow)
    axes.text(1.1 * east, 1.1 * up, "N", ha="center", va="center", fontsize=11, weight="bold", color=_INK)
    if not is_true:
        axes.text(0.0, -1.25, "grid", ha="center", va="top", fontsize=7, color=_FAINT)


# --- Legend and facts -------------------------------------------------------------------------------------------------


def _draw_legend(figure: "Figure", scale: MapScale, values: np.ndarray, caption: str) -> float:
    """Draw the legend and return the height of its lower edge, in pages."""
    figure.text(_FACTS, 0.845, caption, fontsize=11, weight="bold", color=_INK)
    if scale.classes:
        return _draw_classes(figure, scale, values)
    axes = figure.add_axes((_FACTS, 0.80, 0.26, 0.025))
    colours = scale.colours(np.linspace(scale.low, scale.high, 512))[None]
    axes.imshow(colours, aspect="auto", extent=(scale.low, scale.high or 1.0, 0.0, 1.0), interpolation="nearest")
    ticks = scale.ticks()
    texts = [each.removesuffix(f" {scale.unit}") for each in map(scale.text, ticks)]
    axes.set_xticks(ticks, texts, fontsize=8)
    axes.set_yticks([])
    if not len(values):
        return 0.73
    least, middle, most = (scale.text(float(x)) for x in np.percentile(values, (0, 50, 100)))
    figure.text(_FACTS, 0.735, f"{least} to {most}, median {middle}", fontsize=9, color=_FAINT)
    return 0.715


def _draw_classes(figure: "Figure", scale: MapScale, values: np.ndarray) -> float:
    """Draw a row per class, with its share of the sensors."""
    top = 0.82
    for each in scale.classes:
        share = f"   {np.mean(values == each.value):.1%} of the sensors" if len(values) else ""
        top = _draw_key(figure, tuple(part / 255.0 for part in each.colour), each.name + share, top)
    return top


def _draw_key(figure: "Figure", colour: Any, text: str, top: float) -> float:
    """Draw a colour and its meaning, and return the height of the next row."""
    from matplotlib.patches import Rectangle

    box = Rectangle((_FACTS, top - 0.018), 0.028, 0.022, facecolor=colour, edgecolor=_FAINT, linewidth=0.4)
    box.set_transform(figure.transFigure)
    figure.add_artist(box)
    figure.text(_FACTS + 0.038, top - 0.007, text, fontsize=10, va="center", color=_INK)
    return top - 0.036


def _draw_facts(figure: "Figure", table: Any, top: float) -> None:
    """Draw the facts below the legend, as many as fit."""
    for name, text in facts_of(table):
        lines = wrap(text, _LETTERS) or [""]
        if top - _LINE * (len(lines) + 1) < 0.06:
            return
        figure.text(_FACTS, top - _LINE, name, fontsize=8, color=_FAINT, va="bottom")
        for k, line in enumerate(lines):
            figure.text(_FACTS, top - _LINE * (k + 1.9), line, fontsize=9, color=_INK, va="bottom")
        top -= _LINE * (len(lines) + 1.35)
    figure.text(_FACTS, 0.025, f"Antumbra {VERSION}", fontsize=7, color=_FAINT)


def facts_of(table: Any) -> Iterator[tuple[str, str]]:
    """Yield names and texts: the scene, the rule and its areas, the dates, the place, the CRS and the sensors."""
    about, sensors = table.about, table.sensors
    if table.scene is not None:
        yield "scene", table.scene.name
    if "rule" in about:
        yield "rule", f"{about['rule']}: {about.get('citation', '')}".rstrip(": ")
    for area in about.get("areas", [])[:_MOST_AREAS]:
        yield f"area {area['name']}", _area_text(area)
    if "first" in about and "last" in about:
        yield "dates", f"{_minutes(about['first'])} to {_minutes(about['last'])}"
        yield "sun", f"{about['suns']:,} positions, {about['hours']:,.4g} h above the horizon"
    if "latitude" in about:
        yield (
            "place",
            f"{about['latitude']:.5f}, {about['longitude']:.5f} (WGS 84); {about.get('timezone') or 'solar zone'}",
        )
    if about.get("observers"):
        yield "observers", f"{about['observers']:,}"
    if about.get("trees"):
        yield "trees", str(about["trees"])
    if about.get("crs"):
        yield "reference system", str(about["crs"])
    cell = "" if sensors.raster is None else f", cells of {sensors.raster.spacing:g} m"
    yield "sensors", f"{len(sensors):,} ({sensors.kind}{cell})"


def _minutes(text: str) -> str:
    """A time without its seconds."""
    return str(text).replace("T", " ")[:16]


def _area_text(area: dict[str, Any]) -> str:
    if area.get("sun_hours") is None:
        return "no cells"
    text = f"mean {area['sun_hours']:.1f} h"
    if area.get("share") is not None:
        text += f"; {area['share']:.1%} of the cells: {'passes' if area['passes'] else 'fails'}"
    return text


def checked_title(title: str | None) -> str | None:
    """A title of one line; otherwise an InputError."""
    if title is not None and (not isinstance(title, str) or "\n" in title or not title.strip()):
        raise InputError(f"title is {title!r}; give one line of text, or leave it out")
    return title
