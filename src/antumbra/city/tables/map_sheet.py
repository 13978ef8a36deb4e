"""Map sheets of tables: a map of the sensors with its legend, beside the facts.

The legend ends at the true extremes of the values. Continuous quantities are interpolated between the centres of the
cells of a raster; whole numbers and classes are drawn as cells.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .false_colours import column_values
from .map_page import (
    COLUMN,
    DPI,
    FAINT,
    PAGE,
    PICTURE,
    TOP,
    Extent,
    draw_caption,
    draw_facts,
    draw_frame,
    draw_key,
    framed,
    minutes_text,
    new_page,
    place_facts,
    save_page,
)
from .map_scale import MapScale, map_scale

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NOWHERE = "#d9d9dc"
"""Colour of sensors without a value."""

_MOST_AREAS = 12


def save_map(table: Any, path: Path, column: str, title: str | None = None) -> None:
    """Write the map sheet of a column of a `Table`."""
    save_page(path, lambda: map_figure(table, column, title))


def map_figure(table: Any, column: str, title: str | None = None) -> "Figure":
    """The sheet as a figure of matplotlib."""
    values, known = column_values(table, column)
    chosen = table.columns[column]
    scale = map_scale(chosen.values, known, chosen.unit)
    figure = new_page(title or chosen.about[:1].upper() + chosen.about[1:] or column)
    axes = figure.add_axes(PICTURE)
    extent = _draw_values(axes, table, np.where(known, values, np.nan), scale)
    _draw_marks(axes, table)
    draw_frame(figure, axes, extent, table.about)
    draw_caption(figure, f"{column} [{chosen.unit}]" if chosen.unit else column)
    top = _draw_legend(figure, scale, values[known])
    if not known.all():
        top = draw_key(figure, NOWHERE, "no value", top)
    draw_facts(figure, facts_of(table), top)
    return figure


# --- The map ----------------------------------------------------------------------------------------------------------


def plan_positions(table: Any, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) float64: easting and northing of world points."""
    y_up = table.scene is not None and table.scene.up == "y"
    return np.stack([points[:, 0], -points[:, 2]], 1) if y_up else points[:, :2]


def _draw_values(axes: "Axes", table: Any, values: np.ndarray, scale: MapScale) -> Extent:
    """Draw the values, NaN in grey, and return the bounds of the map."""
    raster = table.sensors.raster
    if raster is not None:
        east, south = raster.west + raster.columns * raster.spacing, raster.north - raster.rows * raster.spacing
        extent = Extent(raster.west, south, east, raster.north)
        cells = table.sensors.on_raster(values)
        axes.imshow(_pixels(cells, scale), extent=(extent.west, east, south, extent.north), interpolation="nearest")
        return extent
    faces = table.sensors.kind == "face" and table.scene is not None
    return (_draw_faces if faces else _draw_points)(axes, table, values, scale)


def _pixels(cells: NDArray[np.float64], scale: MapScale) -> NDArray[np.uint8]:
    """(h, w, 4) uint8: the cells of a raster; a continuous quantity is interpolated."""
    if not (scale.classes or scale.whole):
        cells = smooth_cells(cells, max(1, int(DPI * PAGE[0] * PICTURE[2]) // max(cells.shape)))
    known = np.isfinite(cells)
    colours = np.full((*cells.shape, 4), 255, np.uint8)
    colours[..., :3] = scale.colours(np.where(known, cells, scale.low))
    colours[~known] = tuple(int(NOWHERE[k : k + 2], 16) for k in (1, 3, 5)) + (255,)
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
    grey = [int(NOWHERE[k : k + 2], 16) for k in (1, 3, 5)]
    return np.where(known[:, None], scale.colours(np.where(known, values, scale.low)), grey) / 255.0


def _draw_faces(axes: "Axes", table: Any, values: np.ndarray, scale: MapScale) -> Extent:
    """Draw faces from above, the highest last."""
    from matplotlib.collections import PolyCollection

    from ..sensors.sensors import corners_of

    corners = corners_of(table.scene)[table.sensors.faces]
    up = "xyz".index(table.scene.up)
    order = np.argsort(corners[..., up].max(1), kind="stable")
    plan = plan_positions(table, corners.reshape(-1, 3)).reshape(-1, 3, 2)[order]
    colours = _hex_colours(values[order], scale)
    axes.add_collection(PolyCollection(list(plan), facecolors=colours, edgecolors=colours, linewidths=0.2))
    return framed(plan.reshape(-1, 2))


def _draw_points(axes: "Axes", table: Any, values: np.ndarray, scale: MapScale) -> Extent:
    """Draw a dot per sensor, the highest last."""
    sensors = table.sensors
    up = "xyz".index("z" if table.scene is None else table.scene.up)
    order = np.argsort(sensors.points[:, up], kind="stable")
    plan = plan_positions(table, sensors.points)[order]
    size = float(np.clip(60_000.0 / max(len(plan), 1), 2.0, 60.0))
    axes.scatter(plan[:, 0], plan[:, 1], s=size, c=_hex_colours(values[order], scale), linewidths=0.0)
    return framed(plan)


def _draw_marks(axes: "Axes", table: Any) -> None:
    if table.marks is not None and len(table.marks):
        plan = plan_positions(table, table.marks)
        axes.scatter(plan[:, 0], plan[:, 1], s=36, c="white", edgecolors="black", linewidths=1.2, zorder=5)


# --- Legend and facts -------------------------------------------------------------------------------------------------


def _draw_legend(figure: "Figure", scale: MapScale, values: np.ndarray) -> float:
    """Draw the legend and return the height of its lower edge, in pages."""
    if scale.classes:
        return _draw_classes(figure, scale, values)
    axes = figure.add_axes((COLUMN, 0.80, 0.26, 0.025))
    colours = scale.colours(np.linspace(scale.low, scale.high, 512))[None]
    axes.imshow(colours, aspect="auto", extent=(scale.low, scale.high or 1.0, 0.0, 1.0), interpolation="nearest")
    ticks = scale.ticks()
    texts = [each.removesuffix(f" {scale.unit}") for each in map(scale.text, ticks)]
    axes.set_xticks(ticks, texts, fontsize=8)
    axes.set_yticks([])
    if not len(values):
        return 0.73
    least, middle, most = (scale.text(float(x)) for x in np.percentile(values, (0, 50, 100)))
    figure.text(COLUMN, 0.735, f"{least} to {most}, median {middle}", fontsize=9, color=FAINT)
    return 0.715


def _draw_classes(figure: "Figure", scale: MapScale, values: np.ndarray) -> float:
    """Draw a row per class, with its share of the sensors."""
    top = TOP
    for each in scale.classes:
        share = f"   {np.mean(values == each.value):.1%} of the sensors" if len(values) else ""
        top = draw_key(figure, tuple(part / 255.0 for part in each.colour), each.name + share, top)
    return top


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
        yield "dates", f"{minutes_text(about['first'])} to {minutes_text(about['last'])}"
        yield "sun", f"{about['suns']:,} positions, {about['hours']:,.4g} h above the horizon"
    if about.get("observers"):
        yield "observers", f"{about['observers']:,}"
    yield from place_facts(about)
    cell = "" if sensors.raster is None else f", cells of {sensors.raster.spacing:g} {about.get('length_unit', 'm')}"
    yield "sensors", f"{len(sensors):,} ({sensors.kind}{cell})"


def _area_text(area: dict[str, Any]) -> str:
    if area.get("sun_hours") is None:
        return "no cells"
    text = f"mean {area['sun_hours']:.1f} h"
    if area.get("share") is not None:
        text += f"; {area['share']:.1%} of the cells: {'passes' if area['passes'] else 'fails'}"
    return text
