"""The map sheet of a shadow: its polygons, above the objects that cast it, and their areas."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...base.extras import import_extra
from ..tables.map_page import (
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
)
from ..tables.map_scale import range_scale

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SHADOW, _CASTERS = "#3d4756", "#c9b79c"
_CHANGES = {"new": "#b2182b", "gone": "#4393c3", "both": "#b9c0ca"}
"""Value of the column "change" -> colour."""


class _Group(NamedTuple):
    """Polygons of one colour."""

    name: str
    colour: Any  # of matplotlib
    shapes: list[Any]  # shapely geometries
    area: float  # m2


def shadow_figure(shadow: Any, title: str | None = None) -> "Figure":
    """The sheet of a `Shadow` as a figure of matplotlib."""
    figure = new_page(title or ("Hours of shadow" if "days" in shadow.about else "Shadow"))
    axes, groups = figure.add_axes(PICTURE), _groups(shadow)
    for group in groups:
        _draw_polygons(axes, group)
    if shadow.casters is not None:
        _draw_casters(axes, shadow.casters)
    draw_frame(figure, axes, _extent(shadow), shadow.about)
    draw_caption(figure, "area [m2]")
    top = TOP
    for group in groups:
        top = draw_key(figure, group.colour, f"{group.name}   {group.area:,.1f}", top)
    if shadow.casters is not None:
        top = draw_key(figure, _CASTERS, "casts it", top)
    draw_facts(figure, shadow_facts(shadow), top)
    return figure


def _groups(shadow: Any) -> list[_Group]:
    """The classes of hours, or all polygons."""
    columns = shadow.columns
    if "change" in columns:
        return [
            _Group(name, colour, list(shadow.polygons[rows]), float(columns["area"][rows].sum()))
            for name, colour in _CHANGES.items()
            if (rows := columns["change"] == name).any()
        ]
    if "hours_from" not in columns:
        return [_Group("shadow", _SHADOW, list(shadow.polygons), shadow.area)]
    scale = range_scale(columns["hours_from"], columns["hours_to"], "h")
    groups = list[_Group]()
    for each in scale.classes:
        rows = columns["hours_from"] == each.value
        colour = tuple(part / 255.0 for part in each.colour)
        groups.append(_Group(each.name, colour, list(shadow.polygons[rows]), float(columns["area"][rows].sum())))
    return groups


def _draw_polygons(axes: "Axes", group: _Group) -> None:
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

    style: dict[str, Any] = {"facecolors": _CASTERS, "edgecolors": _CASTERS, "linewidths": 0.2}
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
    return framed(np.concatenate(corners))


def shadow_facts(shadow: Any) -> Iterator[tuple[str, str]]:
    """Yield names and texts: the scene, the moment or the days, the sun, where the shadow falls, and the place."""
    about = shadow.about
    yield "scene", about["scene"]
    if "days" in about:
        yield "days", f"{about['days']}, {about['hours']:,.4g} h of daylight"
    else:
        yield "time", minutes_text(about["time"])
        yield "sun", f"azimuth {about['sun_azimuth']:.1f}, elevation {about['sun_elevation']:.1f} degrees"
    if "height" in about:
        yield "falls on", f"a horizontal plane at a height of {about['height']:,.6g}"
    elif about.get("cell"):
        yield "falls on", f"cells of {about['cell']:g}"
    yield from place_facts(about)
