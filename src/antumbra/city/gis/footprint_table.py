"""Building footprints with heights: read with geopandas, checked, and split into polygons of rings.

A footprint is a polygon or multipolygon in a row of a table. Rows that cannot become a solid are named in an error, or
left out and counted.
"""

from os import PathLike
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.checks import choice, path_of, quoted
from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.files import checked_file
from ...base.wording import counted
from ...formats.foreign_formats import cure_of
from ...scene.crs import check_horizontal_crs, checked_crs, in_one_unit, unit_of_crs
from ...scene.units import LengthUnit
from .length_texts import LENGTH_FORMS, STOREY, counts_storeys, lengths_in
from .vector_table import NamedRows, given_numbers, id_column, read_layer

SUFFIXES = (".gpkg", ".geojson", ".shp", ".fgb", ".parquet")
"""Suffixes of files of footprints."""

FootprintsLike: TypeAlias = "str | PathLike[str] | Any"
"""Footprints: a path, or a GeoDataFrame of geopandas."""

_HEIGHT = "height"  # default column of heights
_IDS = "id", "identificatie", "gml_id", "osm_id", "fid"  # columns that name footprints, in this order
_LONGEST = 20  # characters of a text in a message
_POLYGON, _MULTIPOLYGON = 3, 6  # geometry types of shapely


class FootprintOptions(NamedTuple):
    """How rows become buildings; `antumbra.from_footprints` documents the fields."""

    height: Any = None
    base: Any = 0.0  # a number, or the name of a column; ignored on terrain
    id: str | None = None
    layer: str | None = None
    invalid: str = "raise"  # or "skip"
    crs: str | None = None  # to which footprints in degrees are projected
    unit: LengthUnit | None = None  # of the coordinates, if no CRS names it


class PolygonRings(NamedTuple):
    """Polygons as rings of corners, without a closing one: outer rings counter-clockwise, holes clockwise."""

    corners: NDArray[np.float64]  # (c, 2) easting and northing
    sizes: NDArray[np.int64]  # (r,) number of corners of each ring
    rings_in: NDArray[np.int64]  # (p,) number of rings of each polygon; the first is the outer one
    footprint: NDArray[np.int64]  # (p,) row of each polygon in `Footprints`

    @property
    def polygon_of_corner(self) -> NDArray[np.int64]:
        """(c,) int64."""
        return np.repeat(np.repeat(np.arange(len(self.rings_in)), self.rings_in), self.sizes)

    @property
    def following(self) -> NDArray[np.int64]:
        """(c,) int64: the next corner of each corner's ring."""
        ends = np.cumsum(self.sizes)
        following = np.arange(1, len(self.corners) + 1)
        following[ends - 1] = ends - self.sizes
        return following


class Footprints(NamedTuple):
    """n footprints with a height each."""

    file: str  # name in errors
    rings: PolygonRings
    ids: list[str]
    heights: NDArray[np.float64]  # (n,) above the base, positive
    bases: NDArray[np.float64]  # (n,)
    attributes: dict[str, NDArray[Any]]  # columns of the table, (n,) each
    crs: str | None
    notes: list[str]


def read_footprints(table: FootprintsLike, options: FootprintOptions) -> Footprints:
    """The footprints of a file or GeoDataFrame.

    Raises
    ------
    InputError
        If the table cannot be read, a column is missing, a CRS is in degrees, or a footprint is invalid and
        ``options.invalid`` is "raise".
    """
    choice(options.invalid, "invalid", ("raise", "skip"))
    frame, file = _frame_of(table, options.layer)
    if not len(frame):
        raise InputError(f"{file}: has no footprints")
    frame = _projected(frame, options.crs, file)
    shapes = import_extra("shapely", "footprints", "gis").force_2d(np.asarray(frame.geometry.array, object))
    columns = {str(name): frame[name] for name in frame.columns if name != frame.geometry.name}
    height = _HEIGHT if options.height is None else options.height
    rows = NamedRows(file, "footprint", len(frame))
    metres = unit_of_crs(None if frame.crs is None else checked_crs(frame.crs), options.unit).metres
    heights, unread = _lengths(height, "height", columns, rows, metres)
    bases, unread_bases = np.zeros(len(frame)), np.full(len(frame), None, object)
    if options.base is not None:
        bases, unread_bases = _lengths(options.base, "base", columns, rows, metres)
    ids = _ids(options.id, columns, frame, rows)
    faults = _faults(shapes, heights, bases)
    for what, texts in (("base", unread_bases), ("height", unread)):
        for k in np.flatnonzero(texts != None).tolist():  # noqa: E711 - of each element
            faults[k] = f"has the {what} {texts[k][:_LONGEST]!r}, which is no length; write {LENGTH_FORMS}"
    bad = np.flatnonzero(faults != "")
    if len(bad) and options.invalid == "raise":
        raise InputError(_message(file, ids, faults, bad))
    if len(bad) == len(frame):
        raise InputError(f"{file}: no footprint is valid; the first one, {ids[0]!r}, {faults[0]}")
    good = np.flatnonzero(faults == "")
    notes = list[str]()
    if isinstance(height, str) and counts_storeys(height):
        notes = [f"{file}: each storey of the column {height!r} is taken to be {STOREY:g} m high"]
    if len(bad):
        notes += [f"{file}: left out {counted(len(bad), 'footprint')}; the first, {ids[bad[0]]!r}, {faults[bad[0]]}"]
    attributes = {name: _values(column)[good] for name, column in columns.items()}
    crs = None if frame.crs is None else in_one_unit(checked_crs(frame.crs))[0]  # heights are in the unit of the plan
    rings = _rings_of(shapes[good])
    chosen = [ids[k] for k in good.tolist()]
    return Footprints(file, rings, chosen, heights[good], bases[good], attributes, crs, notes)


# --- Tables -----------------------------------------------------------------------------------------------------------


def _frame_of(table: FootprintsLike, layer: str | None) -> tuple[Any, str]:
    """A GeoDataFrame, and its name in errors."""
    geopandas = import_extra("geopandas", "footprints", "gis")
    if isinstance(table, geopandas.GeoDataFrame):
        return table, "the footprints"
    if not isinstance(table, (str, PathLike)):
        raise InputError(f"footprints are {quoted(table)}; give the path of a file, or a GeoDataFrame")
    path = path_of(table, "footprints")
    checked_file(path, path.name)
    if path.suffix.lower() not in SUFFIXES:
        cure = cure_of(path) or f"unknown format of footprints; use one of {', '.join(SUFFIXES)}"
        raise InputError(f"{path.name}: {cure}")
    return read_layer(path, layer, "footprints", lambda kind: "Point" not in kind and "Line" not in kind), path.name


def _projected(frame: Any, crs: str | None, file: str) -> Any:
    """A table in a projected CRS: one in degrees is transformed to `crs`, which must be that of all others."""
    if frame.crs is None:
        return frame if crs is None else frame.set_crs(crs)
    if not frame.crs.is_geographic:
        check_horizontal_crs(file, frame.crs.to_string(), crs)
        return frame
    if crs is None:
        guess = frame.estimate_utm_crs().to_string() if len(frame.geometry.dropna()) else "EPSG:28992"
        name = frame.crs.to_string()[:40]
        raise InputError(f"{file}: its CRS, {name}, is in degrees; project it: crs={guess!r}, or --crs {guess}")
    return frame.to_crs(crs)


def _lengths(
    value: Any, what: str, columns: dict[str, Any], rows: NamedRows, metres: float
) -> tuple[NDArray[np.float64], NDArray[np.object_]]:
    """Lengths from a number, an array or the name of a column, NaN: missing; and the texts that are no lengths.

    metres : per unit of the coordinates
    """
    numbers = given_numbers(value, what, columns, rows)
    if numbers is not None:
        return numbers, np.full(rows.n, None, object)
    lengths, unread = lengths_in(_values(columns[value]), metres)
    return lengths * (STOREY / metres if counts_storeys(value) else 1.0), unread


def _values(column: Any) -> NDArray[Any]:
    """The numbers of a column, or its other values, with None where they are missing."""
    if column.dtype.kind in "fiu":
        return np.asarray(column)
    return np.asarray(column.astype(object).where(column.notna(), None), object)


def _ids(name: str | None, columns: dict[str, Any], frame: Any, rows: NamedRows) -> list[str]:
    column = id_column(name, columns, _IDS, rows)
    return [str(each) for each in (frame.index if column is None else columns[column])]


# --- Faults -----------------------------------------------------------------------------------------------------------


def _faults(shapes: NDArray[Any], heights: NDArray[np.float64], bases: NDArray[np.float64]) -> NDArray[np.str_]:
    """(n,) str: why a footprint has no solid; "": it has one."""
    import shapely

    faults = np.full(len(shapes), "", dtype="U120")
    for values, what in ((bases, "base"), (heights, "height")):
        faults[~np.isfinite(values)] = f"has no {what}"
    faults[heights <= 0.0] = "has a height of 0 or less"
    polygons = np.isin(shapely.get_type_id(shapes), (_POLYGON, _MULTIPOLYGON))
    for k in np.flatnonzero(polygons & ~shapely.is_valid(shapes)).tolist():
        faults[k] = f"is invalid ({shapely.is_valid_reason(shapes[k])})"
    faults[polygons & ~(shapely.area(shapely.convex_hull(shapes)) > 0.0)] = "has no area"
    faults[~polygons] = "is no polygon"
    faults[shapely.is_missing(shapes) | shapely.is_empty(shapes)] = "has no geometry"
    return faults


def _message(file: str, ids: list[str], faults: np.ndarray, bad: np.ndarray) -> str:
    more = f" (and {counted(len(bad) - 1, 'more footprint', 'have')} faults)" if len(bad) > 1 else ""
    cure = "repair it, or leave such footprints out: invalid='skip', or FILE?invalid=skip"
    return f"{file}: footprint {ids[bad[0]]!r} {faults[bad[0]]}{more}; {cure}"


# --- Rings ------------------------------------------------------------------------------------------------------------


def _rings_of(shapes: NDArray[Any]) -> PolygonRings:
    """The rings of valid polygons and multipolygons."""
    import shapely

    parts, footprint = shapely.get_parts(shapes, return_index=True)
    _, points, (ring_starts, polygon_starts) = shapely.to_ragged_array(parts)
    sizes = np.diff(ring_starts) - 1  # without the closing corner
    inside = np.ones(len(points), bool)
    inside[ring_starts[1:] - 1] = False
    rings = PolygonRings(points[inside].astype(np.float64), sizes, np.diff(polygon_starts), footprint.astype(np.int64))
    return _without_straight_corners(_oriented(rings))


def _areas(rings: PolygonRings) -> NDArray[np.float64]:
    """(r,) float64: twice the signed areas of rings, positive if counter-clockwise."""
    starts = np.cumsum(rings.sizes) - rings.sizes
    local = rings.corners - np.repeat(rings.corners[starts], rings.sizes, 0)
    after = local[rings.following]
    out: NDArray[np.float64] = np.add.reduceat(local[:, 0] * after[:, 1] - local[:, 1] * after[:, 0], starts)
    return out


def _oriented(rings: PolygonRings) -> PolygonRings:
    """Rings in the order that `PolygonRings` states."""
    outer = np.zeros(len(rings.sizes), bool)
    outer[np.cumsum(rings.rings_in) - rings.rings_in] = True
    turned = np.repeat((_areas(rings) > 0.0) != outer, rings.sizes)
    ends = np.cumsum(rings.sizes)
    place = np.arange(len(rings.corners))
    mirrored = np.repeat(2 * ends - rings.sizes - 1, rings.sizes) - place
    return rings._replace(corners=rings.corners[np.where(turned, mirrored, place)])


def _without_straight_corners(rings: PolygonRings) -> PolygonRings:
    """Rings without corners on the line between their neighbours, which ear clipping would drop from the roof only."""
    while True:
        starts = np.cumsum(rings.sizes) - rings.sizes
        first = starts[np.cumsum(rings.rings_in) - rings.rings_in]
        local = rings.corners - rings.corners[first][rings.polygon_of_corner]
        after = local[rings.following]
        before = np.empty_like(local)
        before[rings.following] = local
        cross = (local[:, 1] - before[:, 1]) * (after[:, 0] - local[:, 0])
        straight = cross == (local[:, 0] - before[:, 0]) * (after[:, 1] - local[:, 1])
        straight[1:] &= ~straight[:-1]  # one of two neighbours at a time
        straight &= np.repeat(rings.sizes > 3, rings.sizes)
        if not straight.any():
            return rings
        dropped = np.add.reduceat(straight.astype(np.int64), starts)
        rings = rings._replace(corners=rings.corners[~straight], sizes=rings.sizes - dropped)
