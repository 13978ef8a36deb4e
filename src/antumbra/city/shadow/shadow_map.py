"""The map sheet of a shadow: its polygons, above the objects that cast it, and their areas."""

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...base.extras import import_extra
from ...base.wording import counted
from ..sheets.map_frame import Extent, MapFit, bounds_of, draw_frame
from ..sheets.method_facts import minutes_text, place_facts, unit_of
from ..sheets.page import Page, TextColumn
from ..sheets.scene_plan import draw_outlines, outlines_of
from ..sheets.sheet import SheetContent
from ..sheets.sheet_options import Sheet
from ..sheets.sheet_tables import SheetTable, cell_text
from ..sheets.units_text import area_text, area_unit
from ..tables.map_scale import range_scale

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SHADOW, CASTERS = "#3d4756", "#d8c6a8"
_CHANGES = {"new": "#b2182b", "gone": "#4393c3", "both": "#b9c0ca"}
"""Value of the column "change" -> colour."""
_MOST_ROWS = 1000


class _ColourGroup(NamedTuple):
    """Polygons of one colour."""

    name: str
    colour: Any  # of matplotlib
    shapes: list[Any]  # shapely geometries
    area: float  # m2


def shadow_report(shadow: Any) -> SheetContent:
    """The content of the sheet of a `Shadow`."""
    about, margin = shadow.about, 2.0 if shadow.casters is None else 5.0
    return SheetContent(
        "Hours of shadow" if "days" in about else "Shadow",
        about,
        partial(_draw_map, shadow),
        _extent(shadow),
        unit=unit_of(about),
        margin=margin,
        tables=lambda: [_table(shadow)],
        counts=[("polygons", f"{len(shadow.polygons):,}")],
        scene=shadow.scene,
    )


def _draw_map(shadow: Any, page: Page, fit: MapFit | None, sheet: Sheet) -> None:
    assert fit is not None
    axes, groups, unit = page.axes(fit.layout.map), groups_of(shadow), unit_of(shadow.about)
    for group in groups:
        _draw_polygons(axes, group)
    if shadow.casters is not None:
        _draw_casters(axes, shadow.casters)
    if shadow.scene is not None:
        draw_outlines(axes, outlines_of(shadow.scene, fit.extent))
    about = shadow.about
    draw_frame(page, axes, fit, unit, float(about.get("north", 0.0)), "latitude" in about)
    panel = TextColumn(page, fit.layout.panel)
    panel.lines(f"area [{area_unit(unit).name}²]", 10, weight="bold")
    panel.gap(1.5)
    for group in groups:
        panel.key(group.colour, f"{group.name}: {area_text(group.area, unit)}")
    if shadow.casters is not None:
        panel.key(CASTERS, "casts it")
    panel.next_part()
    panel.facts(shadow_facts(shadow))


def groups_of(shadow: Any) -> list[_ColourGroup]:
    """The classes of hours, or all polygons."""
    columns = shadow.columns
    if "change" in columns:
        return [
            _ColourGroup(name, colour, list(shadow.polygons[rows]), float(columns["area"][rows].sum()))
            for name, colour in _CHANGES.items()
            if (rows := columns["change"] == name).any()
        ]
    if "hours_from" not in columns:
        return [_ColourGroup("shadow", _SHADOW, list(shadow.polygons), shadow.area)]
    scale = range_scale(columns["hours_from"], columns["hours_to"], "h")
    groups = list[_ColourGroup]()
    for each in scale.classes:
        rows = columns["hours_from"] == each.value
        colour = tuple(part / 255.0 for part in each.colour)
        groups.append(_ColourGroup(each.name, colour, list(shadow.polygons[rows]), float(columns["area"][rows].sum())))
    return groups


def _draw_polygons(axes: "Axes", group: _ColourGroup) -> None:
    """Draw polygons with their holes."""
    from matplotlib.collections import PathCollection
    from matplotlib.path import Path

    shapely = import_extra("shapely", "a map sheet", "gis")
    paths = []
    for shape in group.shapes:
        rings = [
            shapely.get_coordinates(ring)
            for polygon in shapely.get_parts(shapely.normalize(shape))  # holes run against outlines
            for ring in (polygon.exterior, *polygon.interiors)
        ]
        paths.append(Path.make_compound_path(*(Path(ring, closed=True) for ring in rings)))
    axes.add_collection(PathCollection(paths, facecolors=[group.colour], edgecolors="none"))


def _draw_casters(axes: "Axes", casters: np.ndarray) -> None:
    """Draw casters, (n, 3, 2) easting and northing, as pixels: they are too many triangles for vector output."""
    from matplotlib.collections import PolyCollection

    style: dict[str, Any] = {"facecolors": CASTERS, "edgecolors": CASTERS, "linewidths": 0.2}
    axes.add_collection(PolyCollection(list(casters), rasterized=True, **style))


def _extent(shadow: Any) -> Extent:
    """The bounds of the cells, or of all polygons and objects."""
    raster = None if shadow.table is None else shadow.table.sensors.raster
    if raster is not None:
        east, south = raster.west + raster.columns * raster.spacing, raster.north - raster.rows * raster.spacing
        return Extent(raster.west, south, east, raster.north)
    corners = [np.empty((0, 2))] if shadow.casters is None else [shadow.casters.reshape(-1, 2)]
    if len(shadow.polygons):
        corners.append(import_extra("shapely", "a map sheet", "gis").get_coordinates(shadow.polygons))
    return bounds_of(np.concatenate(corners))


def _table(shadow: Any) -> SheetTable:
    """A row per polygon, with its area in the unit of the coordinates; the largest ones if they are very many."""
    unit = area_unit(unit_of(shadow.about))
    headers = [f"{name} ({unit.name}²)" if name == "area" else name.replace("_", " ") for name in shadow.columns]
    columns = {
        name: values / unit.square_metres if name == "area" else values for name, values in shadow.columns.items()
    }
    order = np.arange(len(shadow.polygons))
    note = ""
    if len(order) > _MOST_ROWS:
        order = np.sort(np.argsort(-columns["area"], kind="stable")[:_MOST_ROWS])
        note = f"The {_MOST_ROWS:,} largest of {counted(len(shadow.polygons), 'polygon')}."
    rows = [[str(k + 1), *(cell_text(values[k]) for values in columns.values())] for k in order.tolist()]
    right = frozenset(k + 1 for k, values in enumerate(columns.values()) if values.dtype.kind in "fiu")
    return SheetTable("Polygons", ["polygon", *headers], rows, right | {0}, note=note)


def shadow_facts(shadow: Any) -> Iterator[tuple[str, str]]:
    """Yield names and texts: the scene, the moment or the days, the sun, where the shadow falls, and the place."""
    about = shadow.about
    unit = unit_of(about).name
    yield "scene", about["scene"]
    if "days" in about:
        yield "days", f"{about['days']}, {about['hours']:,.4g} h of daylight"
    else:
        yield "time", minutes_text(about["time"])
        yield "sun", f"azimuth {about['sun_azimuth']:.1f}, elevation {about['sun_elevation']:.1f} degrees"
    if "height" in about:
        yield "falls on", f"a horizontal plane at a height of {about['height']:,.6g} {unit}"
    elif about.get("cell"):
        yield "falls on", f"cells of {about['cell']:g} {unit}"
    yield from place_facts(about)
