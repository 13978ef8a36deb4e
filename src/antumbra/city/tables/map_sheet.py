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
from ...base.wording import counted
from ...engine.scene import AnyScene
from ...scene.raster import Raster
from ...scene.scene_bounds import plan_points
from ...store.store_data import ALL_BYTES
from ..cityjson.surface_types import WALL
from ..sensors.sensors import Sensors, corners_of
from ..sensors.surface_groups import face_types
from ..sheets.map_frame import Extent, MapFit, bounds_of, draw_frame, fit_map
from ..sheets.map_labels import draw_labels, spread_points
from ..sheets.method_facts import unit_of
from ..sheets.page import DPI, FAINT, INCH, INK, Page, TextColumn
from ..sheets.scene_plan import (
    bounds_of_scene,
    brightness,
    draw_hillshade,
    draw_outlines,
    draw_pixels,
    hillshade,
    outlines_of,
    wall_lines,
)
from ..sheets.sheet import SheetContent, save_report
from ..sheets.sheet_options import Sheet
from ..sheets.units_text import unit_text
from .false_colours import column_values, heading_of
from .interpolated_values import smooth_cells
from .map_legend import (
    CLASS_MARKERS,
    END_MARKERS,
    GAIN_HATCH,
    GAIN_MARKER,
    HATCH,
    LINES,
    MOST_MARKS,
    SightLine,
    draw_legend,
    facts_of,
    is_seen,
    mark_facts,
    mark_labels,
    scale_of,
    sensor_fact,
    shows_points,
)
from .map_scale import MapScale
from .table_pages import tables_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LABELS = "id", "name", "label", "window", "site"  # columns of the user's table, in order of preference
_MARGIN, _POINT_MARGIN = 2.0, 6.0  # millimetres around the map
_CONTEXT = 25.0  # metres shown around single points, or half of their extent
_SHARP = 4.0  # pixels per millimetre of hillshades and classes
_MOST_PIXELS = 3000  # side of a picture
_MOST_FACES = 15_000  # in vector output; more are drawn as pixels
_ONE_OBSERVER = "What the observer sees"
_LEAST = 1e-6  # of the surroundings: a point has an extent, too
_MOST_BUILDINGS = 60  # labelled by themselves
_LARGEST_MARK, _SMALLEST_MARK = 1.5, 0.7  # millimetres: radius of marks of few sensors
_WALL, _CASING = 2.0, 0.8  # points: width of walls in the colours of their values, and of the dark edge more
_MOST_SPREAD = 300  # points that are moved away from others at their place


def save_map(table: Any, path: Path, column: str, sheet: Sheet) -> None:
    """Write the map sheet of a column of a `Table`."""
    save_report(path, table_report(table, column, sheet), sheet)


def table_report(table: Any, column: str, sheet: Sheet, lines: Sequence[SightLine] = ()) -> SheetContent:
    """The content of the map sheet of a column of a `Table`.

    lines : lines of sight to draw

    Raises
    ------
    InputError
        If the table has no rows, or no column of the name of the labels.
    """
    if not len(table):
        raise InputError("the table has no rows; there is nothing to draw on a map")
    about = table.about
    heading = _ONE_OBSERVER if is_seen(table, column) else heading_of(table, column)
    extent, core = _extents_of(table, lines)
    draw = partial(_draw_map, table, column, _labels(table, sheet), list(lines))
    margin = _POINT_MARGIN if shows_points(table) else _MARGIN
    counts = [sensor_fact(table), *mark_facts(table)]
    return SheetContent(
        heading, about, draw, extent, core, unit_of(about), margin, partial(tables_of, table), counts, table.scene
    )


def check_scale(sensors: Sensors, scene: AnyScene, sheet: Sheet, grouped: bool) -> None:
    """Raise an InputError, before a study, if the map of its sensors does not fit at the scale of a sheet.

    grouped : whether rows stand for groups of sensors, whose faces the map shows
    """
    if len(sensors):
        extent, core = _extents_of(_Sensed(sensors, scene, None, sensors if grouped else None), ())
        margin = _POINT_MARGIN if sensors.kind == "points" and not grouped else _MARGIN
        fit_map(extent if sheet.scale is None else core, scene.unit, sheet, margin)


class _Sensed(NamedTuple):
    """What `_extents_of` reads of a table, before there is one."""

    sensors: Sensors
    scene: AnyScene
    marks: None
    row_of_face: object


# --- What the map shows -----------------------------------------------------------------------------------------------


def _extents_of(table: Any, lines: Sequence[SightLine]) -> tuple[Extent, Extent]:
    """What the map shows, and what it must show: cells, the scene, or single points without their surroundings."""
    raster, scene = table.sensors.raster, table.scene
    if raster is not None:
        covered = np.isfinite(table.sensors.on_raster(np.zeros(len(table.sensors))))
        cells = _cells_extent(raster, covered if covered.any() else np.ones_like(covered))
        return cells, cells
    up = "z" if scene is None else scene.up
    plan = [plan_points(each, up) for each in (table.sensors.points, table.marks) if each is not None]
    plan += [np.array([line.begin, line.end]) for line in lines]
    core = bounds_of(np.concatenate(plan))
    if scene is None:
        core = core if core.width or core.height else core.grown(1.0)
        return core, core
    if not shows_points(table):
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
        per = table.about.get("per")
        found = per if per in columns else next((named[name] for name in _LABELS if name in named), None)
        if shows_points(table) and found is not None:
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
        return [" ".join(str(value).split()) for value in values.tolist()]
    return ["" if value != value else f"{value:.0f}" if value.is_integer() else f"{value:.4g}"
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
    if not lines:
        _draw_values(axes, table, shown, scale, fit)
    elif table.scene is not None:
        draw_hillshade(axes, _shade(table.scene, fit.extent, fit), fit.extent)
    if table.scene is not None:
        draw_outlines(axes, outlines_of(table.scene, fit.extent))
    left_out = _draw_lines(axes, lines, fit) if lines else _draw_marks_and_labels(axes, table, labels, fit)
    draw_frame(page, axes, fit, unit_of(about), float(about.get("north", 0.0)), "latitude" in about)
    panel = TextColumn(page, fit.layout.panel)
    chosen = table.columns[column]
    panel.lines(f"{column} [{unit_text(chosen.unit)}]" if chosen.unit else column, 10, weight="bold")
    panel.gap(1.5)
    draw_legend(panel, table, scale, shown, lines)
    if not lines and _places(table, fit)[1]:
        panel.lines("marks at the same place: the lowest first, then outwards", 7, color=FAINT)
    if left_out:
        panel.lines(f"{counted(left_out, 'label')} left out for want of room", 7, color=FAINT)
    panel.next_part()
    panel.facts(facts_of(table))


def _draw_values(axes: "Axes", table: Any, values: np.ndarray, scale: MapScale, fit: MapFit) -> None:
    """Draw the values; hatched where there is none."""
    sensors, scene = table.sensors, table.scene
    if sensors.raster is not None:
        _draw_raster(axes, table, values, scale, fit)
    elif scene is not None and (sensors.kind == "face" or table.row_of_face is not None) and scene.data.fits(ALL_BYTES):
        _draw_faces(axes, table, values, scale, fit)
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
    cells, extent = cells_in(table.sensors.on_raster(values), table.sensors.raster, fit.extent)
    if not cells.size:
        return
    gains = np.nan_to_num(cells) < 0.0 if scale.diverging else np.zeros_like(cells, bool)
    of_cell = fit.layout.map.width / fit.extent.width * extent.width / cells.shape[1]  # millimetres
    most = max(1, _MOST_PIXELS // max(cells.shape))
    if scale.classes:
        parts = int(np.clip(np.ceil(of_cell * _SHARP), 1, most))
        cells = cells.repeat(parts, 0).repeat(parts, 1)
    elif not scale.whole:
        cells = smooth_cells(cells, int(np.clip(of_cell * DPI / INCH, 1, most)))
    known = np.isfinite(cells)
    colours = scale.colours(np.where(known, cells, scale.low))
    if scale.classes and table.scene is not None:
        shade = brightness(hillshade(table.scene, extent, cells.shape[1], cells.shape[0]))
        colours = np.round(np.minimum(colours * shade[..., None], 255.0)).astype(np.uint8)
    if not known.all():
        _hatch(axes, extent)
    draw_pixels(axes, np.dstack([colours, np.where(known, 255, 0).astype(np.uint8)]), extent, zorder=1)
    if gains.any():
        _hatch_gains(axes, gains, extent)


def cells_in(cells: NDArray[np.float64], raster: Raster, extent: Extent) -> tuple[NDArray[np.float64], Extent]:
    """The cells of a raster that a map shows, and their bounds; of very many, those at equal steps, wider."""
    spacing, (rows, columns) = raster.spacing, cells.shape
    west = int(np.clip(np.floor((extent.west - raster.west) / spacing), 0, columns))
    east = int(np.clip(np.ceil((extent.east - raster.west) / spacing), 0, columns))
    north = int(np.clip(np.floor((raster.north - extent.north) / spacing), 0, rows))
    south = int(np.clip(np.ceil((raster.north - extent.south) / spacing), 0, rows))
    step = max(1, -(-max(east - west, south - north) // _MOST_PIXELS))
    some = cells[north + step // 2 : south : step, west + step // 2 : east : step]
    left, top = raster.west + west * spacing, raster.north - north * spacing
    return some, Extent(left, top - some.shape[0] * step * spacing, left + some.shape[1] * step * spacing, top)


def _hatch_gains(axes: "Axes", gains: NDArray[np.bool_], extent: Extent) -> None:
    """Hatch the cells of gains, since they are as dark as some losses in print without colours."""
    from matplotlib.collections import PolyCollection

    wide, high = extent.width / gains.shape[1], extent.height / gains.shape[0]
    runs = []
    for row in np.flatnonzero(gains.any(1)).tolist():
        steps = np.diff(np.concatenate([[0], gains[row].astype(np.int8), [0]]))
        north = extent.north - row * high
        for first, last in zip(np.flatnonzero(steps > 0).tolist(), np.flatnonzero(steps < 0).tolist()):
            west, east = extent.west + first * wide, extent.west + last * wide
            runs.append([(west, north - high), (east, north - high), (east, north), (west, north)])
    style: dict[str, Any] = {"facecolors": "none", "edgecolors": INK, "linewidths": 0.0, "zorder": 2}
    axes.add_collection(PolyCollection(runs, hatch=GAIN_HATCH, rasterized=True, **style))


def _hatch(axes: "Axes", extent: Extent) -> None:
    from matplotlib.patches import Rectangle

    at = extent.west, extent.south
    axes.add_patch(
        Rectangle(at, extent.width, extent.height, hatch=HATCH, facecolor="white", edgecolor="#c4c7cc", lw=0.0)
    )


def _colours(values: np.ndarray, scale: MapScale) -> NDArray[np.float64]:
    """(n, 3) float64 sRGB in [0, 1] of values, white for NaN."""
    known = np.isfinite(values)
    return np.where(known[:, None], scale.colours(np.where(known, values, scale.low)), 255) / 255.0


def _draw_faces(axes: "Axes", table: Any, values: np.ndarray, scale: MapScale, fit: MapFit) -> None:
    """Draw faces from above, the highest last; walls alone as lines. Other faces are a hillshade."""
    from matplotlib.collections import PolyCollection

    corners, of_face = corners_of(table.scene), np.full(table.scene.n_triangles, np.nan)
    if table.row_of_face is None:
        faces = table.sensors.faces
        of_face[faces] = values
    else:
        faces = np.flatnonzero(table.row_of_face >= 0)
        of_face[faces] = values[table.row_of_face[faces]]
    if len(faces) < table.scene.n_triangles:
        draw_hillshade(axes, _shade(table.scene, fit.extent, fit), fit.extent)
    corners = corners[faces]
    order = np.argsort(corners[..., "xyz".index(table.scene.up)].max(1), kind="stable")
    plan = plan_points(corners.reshape(-1, 3), table.scene.up).reshape(-1, 3, 2)[order]
    colours, known = _colours(of_face[faces][order], scale), np.isfinite(of_face[faces][order])
    gains = known & (np.nan_to_num(of_face[faces][order]) < 0.0) if scale.diverging else np.zeros_like(known)
    for some, edges, hatch in ((~known, "#c4c7cc", HATCH), (known & ~gains, None, None), (gains, INK, GAIN_HATCH)):
        if some.any():
            style: dict[str, Any] = {"linewidths": 0.2 if hatch is None else 0.0, "rasterized": len(plan) > _MOST_FACES}
            edge = colours[some] if edges is None else edges
            axes.add_collection(
                PolyCollection(
                    list(plan[some]), facecolors=colours[some], edgecolors=edge, hatch=hatch, zorder=1, **style
                )
            )
    if not table.scene.data.lacks_surfaces and (face_types(table.scene, faces) == WALL).all():
        _draw_walls(axes, corners, of_face[faces], table.scene.up, scale)


def _draw_walls(
    axes: "Axes", corners: NDArray[np.float64], values: NDArray[np.float64], up: str, scale: MapScale
) -> None:
    """Draw walls, (k, 3, 3), as lines in the colours of their values: what fails, or has most, last."""
    from matplotlib.collections import LineCollection

    walls, lines = wall_lines(corners, up)
    values = values[walls]
    order = np.argsort(-values if scale.classes else values, kind="stable")
    order = order[np.isfinite(values[order])]
    for colours, more in ((INK, _CASING), (_colours(values[order], scale), 0.0)):
        style: dict[str, Any] = {"rasterized": len(lines) > _MOST_FACES, "linewidths": _WALL + more, "zorder": 3.5}
        axes.add_collection(LineCollection(list(lines[order]), colors=colours, **style))


def _radius(table: Any, fit: MapFit) -> float:
    """Millimetres: the radius of the marks of sensors; neighbours do not overlap if they can be seen at all then."""
    radius = float(np.clip(np.sqrt(4000.0 / max(len(table), 1)), 0.35, _LARGEST_MARK))
    if not shows_points(table) or len(table) > _MOST_SPREAD:
        return radius
    plan = plan_points(table.sensors.points, "z" if table.scene is None else table.scene.up)
    apart = np.linalg.norm(plan[:, None] - plan, axis=2) * (fit.layout.map.width / fit.extent.width)
    nearest = float(apart[apart > _SMALLEST_MARK].min(initial=np.inf))  # nearer ones are at the same place
    return float(np.clip(nearest / 2.0, _SMALLEST_MARK, radius))


def _places(table: Any, fit: MapFit) -> tuple[NDArray[np.float64], bool]:
    """(n, 2) float64: where the marks of sensors are drawn; and whether some are moved away from others above them."""
    sensors, up = table.sensors, "z" if table.scene is None else table.scene.up
    plan = plan_points(sensors.points, up).astype(np.float64)
    if not shows_points(table) or len(plan) > _MOST_SPREAD:
        return plan, False
    outward = np.tile([0.0, 1.0], (len(plan), 1))
    if sensors.normals is not None:
        level = plan_points(sensors.normals, up)
        length = np.linalg.norm(level, axis=1)
        upright = length > 0.1
        outward[upright] = level[upright] / length[upright, None]
    per_unit, origin = fit.layout.map.width / fit.extent.width, np.array([fit.extent.west, fit.extent.south])
    shown = (plan - origin) * per_unit
    moved = spread_points(shown, sensors.points[:, "xyz".index(up)], outward, 2.3 * _radius(table, fit))
    return np.where(moved[:, None], shown / per_unit + origin, plan), bool(moved.any())


def _draw_points(axes: "Axes", table: Any, values: np.ndarray, scale: MapScale, fit: MapFit) -> None:
    """Draw a mark per sensor, the highest last; a shape per class, and a cross without a value."""
    sensors = table.sensors
    up = "z" if table.scene is None else table.scene.up
    order = np.argsort(sensors.points[:, "xyz".index(up)], kind="stable")
    plan, shown = _places(table, fit)[0][order], values[order]
    radius = _radius(table, fit)
    size = (2.0 * radius * 72.0 / INCH) ** 2
    style: dict[str, Any] = {"s": size, "zorder": 4, "linewidths": 0.4 if radius > 0.8 else 0.0, "edgecolors": INK}
    for marker, some in _by_marker(scale, shown):
        axes.scatter(plan[some, 0], plan[some, 1], c=_colours(shown[some], scale), marker=marker, **style)
    unknown = ~np.isfinite(shown)
    axes.scatter(plan[unknown, 0], plan[unknown, 1], c=FAINT, s=size, marker="x", linewidths=0.6, zorder=4)


def _by_marker(scale: MapScale, values: np.ndarray) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield a marker and the rows that have it."""
    if scale.diverging:
        yield "o", values >= 0.0
        yield GAIN_MARKER, values < 0.0
        return
    if len(scale.classes) != len(CLASS_MARKERS):
        yield "o", np.isfinite(values)
        return
    for marker, each in zip(CLASS_MARKERS, scale.classes):
        yield marker, values == each.value


def _draw_marks_and_labels(axes: "Axes", table: Any, labels: list[str] | None, fit: MapFit) -> int:
    """Draw the table's marks and all labels; return how many labels found no room."""
    up = "z" if table.scene is None else table.scene.up
    plan, texts, radius = [np.empty((0, 2))], list[str](), _radius(table, fit)
    if table.marks is not None and len(table.marks):
        marks = plan_points(table.marks, up)
        axes.scatter(
            marks[:, 0], marks[:, 1], s=36, marker="^", c="white", edgecolors="black", linewidths=1.2, zorder=5
        )
        if 1 < len(marks) <= MOST_MARKS:
            plan, texts, radius = [marks], mark_labels(table), max(radius, 1.3)
    if labels is not None:
        plan.append(_places(table, fit)[0])
        texts += labels
    filled = [k for k, text in enumerate(texts) if text]
    if not filled:
        return 0
    centred = table.row_of_face is not None and len(plan) == 2
    return len(draw_labels(axes, fit, np.concatenate(plan)[filled], [texts[k] for k in filled], radius, centred))


def _draw_lines(axes: "Axes", lines: list[SightLine], fit: MapFit) -> int:
    """Draw lines of sight, and their ends with labels; return how many labels found no room."""
    for line in lines:
        colour, dashes = LINES[line.visible]
        axes.plot(*zip(line.begin, line.end), color=colour, linestyle=dashes, linewidth=1.1, zorder=5)
    begins, ends = ({line.begin: line.begin_name for line in lines}, {line.end: line.end_name for line in lines})
    for marker, places in zip(END_MARKERS, (begins, ends)):
        x, y = np.array(list(places)).T
        axes.scatter(x, y, s=24, marker=marker, c="white", edgecolors=INK, linewidths=1.0, zorder=6)
    named = [(place, name) for places in (begins, ends) for place, name in places.items() if name]
    if not named:
        return 0
    return len(draw_labels(axes, fit, np.array([place for place, _ in named]), [name for _, name in named], 1.0))
