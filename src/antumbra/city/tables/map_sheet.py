"""Map sheets of tables: a map of the sensors with its legend beside facts, then the table, the method and the sources.

The legend ends at the true extremes of the values. Continuous quantities are interpolated between the centres of the
cells of a raster; whole numbers and classes are drawn as cells. Classes lie over a hillshade of the scene.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.checks import quoted, spelling_hint
from ...base.errors import InputError
from ..sensors.sensors import corners_of
from ..sheets.map_frame import Extent, MapFit, bounds_of, draw_frame
from ..sheets.map_labels import draw_labels
from ..sheets.method_facts import minutes_text, place_facts, unit_of
from ..sheets.page import DPI, FAINT, INCH, INK, Column, Page, Rect
from ..sheets.scene_plan import (
    bounds_of_scene,
    brightness,
    draw_hillshade,
    draw_outlines,
    draw_pixels,
    hillshade,
    outlines_of,
    plan_of_points,
)
from ..sheets.sheet import Report, save_report
from ..sheets.sheet_options import Sheet
from ..sheets.units_text import area_text, unit_text
from .false_colours import column_values
from .map_scale import MapScale, map_scale
from .table_pages import tables_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HATCH = "////"
"""Of what has no value: no colour of a scale looks like it."""

_LABELS = "id", "name", "label", "window", "site"  # columns of the user's table, in order of preference
_MARGIN, _POINT_MARGIN = 2.0, 6.0  # millimetres around the map
_CONTEXT = 25.0  # metres shown around single points, or half of their extent
_SHARP = 4.0  # pixels per millimetre of hillshades and classes
_MOST_PIXELS = 3000  # side of a picture
_MOST_FACES = 15_000  # in vector output; more are drawn as pixels
_LEAST = 1e-6  # of the surroundings: a point has an extent, too
_MOST_BUILDINGS = 60  # labelled by themselves
_MOST_MARKS = 30  # labelled
_MOST_AREAS = 12
_CLASS_MARKERS = "s", "o"  # shapes of points of no and yes, for print without colours
_MARKS = {"viewshed": "observer", "visible share": "target"}
_LINES = {True: ("#2b8a5a", "-"), False: ("#b03a1a", (0, (2.5, 1.5)))}  # visible or not -> colour and dashes


class SightLine(NamedTuple):
    """A line of sight in plan."""

    begin: tuple[float, float]
    end: tuple[float, float]
    visible: bool


def save_map(table: Any, path: Path, column: str, sheet: Sheet) -> None:
    """Write the map sheet of a column of a `Table`."""
    save_report(path, table_report(table, column, sheet), sheet)


def table_report(table: Any, column: str, sheet: Sheet, lines: Sequence[SightLine] = ()) -> Report:
    """The content of the map sheet of a column of a `Table`.

    lines : lines of sight to draw

    Raises
    ------
    InputError
        If the table has no rows, or no column of the name of the labels.
    """
    if not len(table):
        raise InputError("the table has no rows; there is nothing to draw on a map")
    chosen, about = table.columns[column], table.about
    heading = chosen.about[:1].upper() + chosen.about[1:] or column
    extent, core = _extents_of(table, lines)
    draw = partial(_draw_map, table, column, _labels(table, sheet), list(lines))
    margin = _POINT_MARGIN if _shows_points(table) else _MARGIN
    return Report(
        heading, about, draw, extent, core, unit_of(about), margin, partial(tables_of, table), [sensor_fact(table)],
        table.scene,
    )  # fmt: skip


def scale_of(table: Any, column: str) -> MapScale:
    """The scale of a column of a `Table`; of values before and after a change, the same one."""
    chosen, name = table.columns[column], column.removesuffix("_before")
    values, known = column_values(table, column)
    twin = name if name != column else f"{name}_before"
    if twin in table.columns and chosen.values.dtype.kind in "iuf":
        others, counted = column_values(table, twin)
        both = np.concatenate([values, others]).astype(chosen.values.dtype)
        return map_scale(both, np.concatenate([known, counted]), chosen.unit, column)
    one = column == "seen" and table.about.get("observers") == 1
    return map_scale(chosen.values, known, chosen.unit, column, yes_or_no=one)


# --- What the map shows -----------------------------------------------------------------------------------------------


def _shows_points(table: Any) -> bool:
    return table.sensors.kind == "points" and table.row_of_face is None


def _extents_of(table: Any, lines: Sequence[SightLine]) -> tuple[Extent, Extent]:
    """What the map shows, and what it must show: cells, the scene, or single points without their surroundings."""
    raster, scene = table.sensors.raster, table.scene
    if raster is not None:
        covered = np.isfinite(table.sensors.on_raster(np.zeros(len(table))))
        cells = _cells_extent(raster, covered if covered.any() else np.ones_like(covered))
        return cells, cells
    up = "z" if scene is None else scene.up
    plan = [plan_of_points(each, up) for each in (table.sensors.points, table.marks) if each is not None]
    plan += [np.array([line.begin, line.end]) for line in lines]
    core = bounds_of(np.concatenate(plan))
    if scene is None:
        core = core if core.width or core.height else core.grown(1.0)
        return core, core
    if not _shows_points(table):
        whole = core.joined(bounds_of_scene(scene))
        return whole, whole
    context = max(scene.unit.of_metres(_CONTEXT), max(core.width, core.height) / 2.0)
    around = core.joined(core.grown(context).within(bounds_of_scene(scene)))
    return around.grown(_LEAST * context), core.grown(_LEAST * context)


def _cells_extent(raster: Any, cells: NDArray[np.bool_]) -> Extent:
    """The bounds of some cells of a raster."""
    rows, columns = np.flatnonzero(cells.any(1)), np.flatnonzero(cells.any(0))
    west, north = raster.west + columns[0] * raster.spacing, raster.north - rows[0] * raster.spacing
    east, south = raster.west + (columns[-1] + 1) * raster.spacing, raster.north - (rows[-1] + 1) * raster.spacing
    return Extent(float(west), float(south), float(east), float(north))


def _labels(table: Any, sheet: Sheet) -> list[str] | None:
    """The label of each row; None: no labels."""
    columns = table.sensors.attributes
    if sheet.labels is None:
        named = {name.lower(): name for name in reversed(columns)}
        found = next((named[name] for name in _LABELS if name in named), None)
        if _shows_points(table) and found is not None:
            return _texts(columns[found])
        if table.row_of_face is not None and "building" in table.columns and len(table) <= _MOST_BUILDINGS:
            return _texts(table["building"])
        return None
    if sheet.labels == "none":
        return None
    columns = table.rows()
    if sheet.labels not in columns:
        hint = spelling_hint(sheet.labels, columns)
        raise InputError(f"labels: there is no column {quoted(sheet.labels)}; {hint}there are {', '.join(columns)}")
    return _texts(columns[sheet.labels])


def _texts(values: np.ndarray) -> list[str]:
    """Labels of values: whole numbers without a point, others with four digits, none for NaN."""
    if values.dtype.kind != "f":
        return [str(value) for value in values.tolist()]
    return ["" if value != value else f"{value:.0f}" if value == int(value) else f"{value:.4g}"
            for value in values.tolist()]  # fmt: skip


# --- The map ----------------------------------------------------------------------------------------------------------


def _draw_map(
    table: Any,
    column: str,
    labels: list[str] | None,
    lines: list[SightLine],
    page: Page,
    fit: MapFit | None,
    sheet: Sheet,
) -> None:
    """Draw the map and its panel on a page."""
    assert fit is not None
    values, known = column_values(table, column)
    scale, about, shown = scale_of(table, column), table.about, np.where(known, values, np.nan)
    axes = page.axes(fit.layout.map)
    _draw_values(axes, table, shown, scale, fit)
    if table.scene is not None:
        draw_outlines(axes, outlines_of(table.scene, fit.extent))
    for line in lines:
        colour, dashes = _LINES[line.visible]
        axes.plot(*zip(line.begin, line.end), color=colour, linestyle=dashes, linewidth=1.1, zorder=5)
    left_out = _draw_marks_and_labels(axes, table, labels, fit)
    draw_frame(page, axes, fit, unit_of(about), float(about.get("north", 0.0)), "latitude" in about)
    panel = Column(page, fit.layout.panel)
    chosen = table.columns[column]
    panel.lines(f"{column} [{unit_text(chosen.unit)}]" if chosen.unit else column, 10, weight="bold")
    panel.gap(1.5)
    _draw_legend(panel, table, scale, shown, lines)
    if left_out:
        panel.lines(f"{left_out} labels left out for want of room", 7, color=FAINT)
    panel.gap(2.0)
    panel.facts(facts_of(table))


def _draw_values(axes: "Axes", table: Any, values: np.ndarray, scale: MapScale, fit: MapFit) -> None:
    """Draw the values; hatched where there is none."""
    sensors, scene = table.sensors, table.scene
    if sensors.raster is not None:
        _draw_raster(axes, table, values, scale, fit)
    elif scene is not None and scene.data.resident and (sensors.kind == "face" or table.row_of_face is not None):
        _draw_faces(axes, table, values, scale)
    else:
        if scene is not None and sensors.kind == "points":
            draw_hillshade(axes, _shade(scene, fit.extent, fit), fit.extent)
        _draw_points(axes, table, values, scale, fit)


def _shade(scene: Any, extent: Extent, fit: MapFit) -> NDArray[np.float64]:
    """The hillshade of a part of the map, as sharp as printed."""
    per_unit = fit.layout.map.width / fit.extent.width
    sides = (int(np.clip(side * per_unit * _SHARP, 2, _MOST_PIXELS)) for side in (extent.width, extent.height))
    return hillshade(scene, extent, *sides)


def _draw_raster(axes: "Axes", table: Any, values: np.ndarray, scale: MapScale, fit: MapFit) -> None:
    """Draw the cells of a raster: classes over a hillshade, continuous quantities smoothly."""
    raster, cells = table.sensors.raster, table.sensors.on_raster(values)
    extent = _cells_extent(raster, np.ones_like(cells, bool))
    pixels_of_cell = fit.layout.map.width / fit.extent.width * raster.spacing * DPI / INCH
    if scale.classes:
        parts = int(np.clip(np.ceil(pixels_of_cell * _SHARP * INCH / DPI), 1, max(1, _MOST_PIXELS // max(cells.shape))))
        cells = cells.repeat(parts, 0).repeat(parts, 1)
    elif not scale.whole:
        cells = smooth_cells(cells, int(np.clip(pixels_of_cell, 1, max(1, _MOST_PIXELS // max(cells.shape)))))
    known = np.isfinite(cells)
    colours = scale.colours(np.where(known, cells, scale.low)).astype(np.float64)
    if scale.classes and table.scene is not None:
        colours *= brightness(hillshade(table.scene, extent, cells.shape[1], cells.shape[0]))[..., None]
    pixels = np.concatenate(
        [np.round(colours).astype(np.uint8), np.where(known, 255, 0).astype(np.uint8)[..., None]], 2
    )
    if not known.all():
        _hatch(axes, extent)
    draw_pixels(axes, pixels, extent, zorder=1)


def _hatch(axes: "Axes", extent: Extent) -> None:
    from matplotlib.patches import Rectangle

    at = extent.west, extent.south
    axes.add_patch(
        Rectangle(at, extent.width, extent.height, hatch=HATCH, facecolor="white", edgecolor="#c4c7cc", lw=0.0)
    )


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


def _colours(values: np.ndarray, scale: MapScale) -> NDArray[np.float64]:
    """(n, 3) float64 sRGB in [0, 1] of values, white for NaN."""
    known = np.isfinite(values)
    return np.where(known[:, None], scale.colours(np.where(known, values, scale.low)), 255) / 255.0


def _draw_faces(axes: "Axes", table: Any, values: np.ndarray, scale: MapScale) -> None:
    """Draw faces from above, the highest last."""
    from matplotlib.collections import PolyCollection

    corners, of_face = corners_of(table.scene), np.full(table.scene.n_triangles, np.nan)
    if table.row_of_face is None:
        faces = table.sensors.faces
        of_face[faces] = values
    else:
        faces = np.flatnonzero(table.row_of_face >= 0)
        of_face[faces] = values[table.row_of_face[faces]]
    corners = corners[faces]
    order = np.argsort(corners[..., "xyz".index(table.scene.up)].max(1), kind="stable")
    plan = plan_of_points(corners.reshape(-1, 3), table.scene.up).reshape(-1, 3, 2)[order]
    colours, known = _colours(of_face[faces][order], scale), np.isfinite(of_face[faces][order])
    style: dict[str, Any] = {"linewidths": 0.2, "rasterized": len(plan) > _MOST_FACES, "zorder": 1}
    if not known.all():
        axes.add_collection(
            PolyCollection(list(plan[~known]), facecolors="white", edgecolors="#c4c7cc", hatch=HATCH, **style)
        )
    axes.add_collection(
        PolyCollection(list(plan[known]), facecolors=colours[known], edgecolors=colours[known], **style)
    )


def _radius(table: Any) -> float:
    """Millimetres: the radius of the marks of sensors."""
    return float(np.clip(np.sqrt(4000.0 / max(len(table), 1)), 0.35, 1.5))


def _draw_points(axes: "Axes", table: Any, values: np.ndarray, scale: MapScale, fit: MapFit) -> None:
    """Draw a mark per sensor, the highest last; a shape per class, and a cross without a value."""
    sensors = table.sensors
    up = "z" if table.scene is None else table.scene.up
    order = np.argsort(sensors.points[:, "xyz".index(up)], kind="stable")
    plan, shown = plan_of_points(sensors.points, up)[order], values[order]
    radius = _radius(table)
    size = (2.0 * radius * 72.0 / INCH) ** 2
    style: dict[str, Any] = {"s": size, "zorder": 4, "linewidths": 0.4 if radius > 0.8 else 0.0, "edgecolors": INK}
    for marker, some in _by_marker(scale, shown):
        axes.scatter(*plan[some].T, c=_colours(shown[some], scale), marker=marker, **style)
    unknown = ~np.isfinite(shown)
    axes.scatter(*plan[unknown].T, c=FAINT, s=size, marker="x", linewidths=0.6, zorder=4)


def _by_marker(scale: MapScale, values: np.ndarray) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield a marker and the rows that have it."""
    if len(scale.classes) != len(_CLASS_MARKERS):
        yield "o", np.isfinite(values)
        return
    for marker, each in zip(_CLASS_MARKERS, scale.classes):
        yield marker, values == each.value


def _draw_marks_and_labels(axes: "Axes", table: Any, labels: list[str] | None, fit: MapFit) -> int:
    """Draw the table's marks and all labels; return how many labels found no room."""
    up = "z" if table.scene is None else table.scene.up
    plan, texts, radius = [np.empty((0, 2))], list[str](), _radius(table)
    if table.marks is not None and len(table.marks):
        marks = plan_of_points(table.marks, up)
        axes.scatter(*marks.T, s=36, marker="^", c="white", edgecolors="black", linewidths=1.2, zorder=5)
        if 1 < len(marks) <= _MOST_MARKS:
            plan, texts, radius = [marks], [str(k) for k in range(len(marks))], max(radius, 1.3)
    if labels is not None:
        at, texts = plan_of_points(table.sensors.points, up), texts + labels
        plan.append(at)
    filled = [k for k, text in enumerate(texts) if text]
    if not filled:
        return 0
    return len(draw_labels(axes, fit, np.concatenate(plan)[filled], [texts[k] for k in filled], radius))


# --- Legend and facts -------------------------------------------------------------------------------------------------


def _draw_legend(panel: Column, table: Any, scale: MapScale, values: np.ndarray, lines: list[SightLine]) -> None:
    """Draw the legend: classes with their shares, or a bar that ends at the extremes, and the median."""
    known = np.isfinite(values)
    if lines:
        _draw_line_keys(panel, lines)
    elif scale.classes:
        _draw_classes(panel, table, scale, values, known)
    else:
        _draw_bar(panel, scale)
        if known.any():
            unit = unit_text(scale.unit)
            least, middle, most = (_number(scale, float(x)) for x in np.percentile(values[known], (0, 50, 100)))
            panel.lines(f"{least} to {most}{f' {unit}' if unit else ''}, median {middle}", 8, color=FAINT)
    if scale.diverging:
        panel.lines("positive: lost; negative: gained", 8, color=FAINT)
    if not known.all() and not lines:
        panel.key("white", "no value", "x" if _shows_points(table) else HATCH)
    if table.marks is not None and len(table.marks):
        name = _MARKS.get(str(table.about.get("job")), "mark")
        panel.key(
            "white",
            name if len(table.marks) == 1 else f"{name}s" + (", by number" * (len(table.marks) <= _MOST_MARKS)),
            "^",
        )


def _number(scale: MapScale, value: float) -> str:
    return scale._replace(unit="").text(value)


def _draw_bar(panel: Column, scale: MapScale) -> None:
    """Draw the colours of a scale above its numbers."""
    at = panel.take(11.0)
    if at is None:
        return
    axes: Any = panel.page.axes(Rect(at.left + 3.0, at.top - 5.0, at.width - 8.0, 5.0))
    low, high = scale.low, scale.high if scale.span else scale.low + 1.0
    colours = scale.colours(np.linspace(low, scale.high, 512))[None]
    axes.imshow(colours, aspect="auto", extent=(low, high, 0.0, 1.0), interpolation="nearest")
    ticks = scale.ticks()
    axes.set_xticks(ticks, [_number(scale, x) for x in ticks], fontsize=7)
    axes.tick_params(length=2, width=0.4, pad=1.5)
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set(color=FAINT, linewidth=0.4)


def _draw_classes(panel: Column, table: Any, scale: MapScale, values: np.ndarray, known: NDArray[np.bool_]) -> None:
    """Draw a key per class, with its share of the sensors, and its area where sensors have one."""
    areas, unit = table.sensors.areas, unit_of(table.about)
    for marker, each in zip(_CLASS_MARKERS, scale.classes):
        rows = values == each.value
        text = each.name
        if known.any():
            text += f"   {rows[known].mean():.1%} of the sensors"
            if areas is not None:
                text += f", {area_text(float(areas[rows].sum()) * unit.square_metres, unit)}"
        colour = tuple(part / 255.0 for part in each.colour)
        panel.key(colour, text, marker if _shows_points(table) else "")


def _draw_line_keys(panel: Column, lines: list[SightLine]) -> None:
    for visible, name in ((True, "visible"), (False, "not visible")):
        colour, dashes = _LINES[visible]
        count = sum(line.visible == visible for line in lines)
        panel.line_key(colour, dashes, f"{name}   {count:,} of {len(lines):,} lines")


def facts_of(table: Any) -> Iterator[tuple[str, str]]:
    """Yield names and texts: the scene, the rule and its areas, the dates, the place, the CRS and the sensors."""
    about = table.about
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
    yield sensor_fact(table)


def sensor_fact(table: Any) -> tuple[str, str]:
    """The number and the kind of the sensors, or of the rows that stand for groups of them."""
    sensors, per = table.sensors, table.about.get("per")
    if per:
        return f"{per}s", f"{len(table):,}"
    cell = "" if sensors.raster is None else f", cells of {sensors.raster.spacing:g} {unit_of(table.about).name}"
    return "sensors", f"{len(sensors):,} ({sensors.kind}{cell})"


def _area_text(area: dict[str, Any]) -> str:
    if area.get("sun_hours") is None:
        return "no cells"
    text = f"mean {area['sun_hours']:.1f} h"
    if area.get("share") is not None:
        text += f"; {area['share']:.1%} of the cells: {'passes' if area['passes'] else 'fails'}"
    return text
