"""Building footprints with heights: read with geopandas, checked, and split into polygons of rings.

A footprint is a polygon or multipolygon in a row of a table. Rows that cannot become a solid are named in an error, or
left out and counted.
"""

from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...checks import as_array, choice, is_number, number, path_of, quoted, spelling_hint, text
from ...errors import InputError
from ...extras import import_extra
from ...files import checked_file
from ...scene.crs import check_horizontal_crs, checked_crs

SUFFIXES = (".gpkg", ".geojson", ".shp", ".fgb", ".parquet")
"""Suffixes of files of footprints."""

FootprintsLike: TypeAlias = "str | PathLike[str] | Any"
"""Footprints: a path, or a GeoDataFrame of geopandas."""

_HEIGHT = "height"  # default column of heights
_IDS = "id", "identificatie", "gml_id", "osm_id", "fid"  # columns that name footprints, in this order
_MOST_NAMES = 12  # in errors
_POLYGON, _MULTIPOLYGON = 3, 6  # geometry types of shapely


class FootprintOptions(NamedTuple):
    """How rows become buildings; `antumbra.from_footprints` documents the fields."""

    height: Any = None
    base: Any = 0.0  # a number, or the name of a column; ignored on terrain
    id: str | None = None
    layer: str | None = None
    invalid: str = "raise"  # or "skip"
    crs: str | None = None  # to which footprints in degrees are projected


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
    heights, bases = _numbers(height, "height", columns, len(frame), file), np.zeros(len(frame))
    if options.base is not None:
        bases = _numbers(options.base, "base", columns, len(frame), file)
    ids = _ids(options.id, columns, frame, file)
    faults = _faults(shapes, heights, bases)
    bad = np.flatnonzero(faults != "")
    if len(bad) and options.invalid == "raise":
        raise InputError(_message(file, ids, faults, bad))
    if len(bad) == len(frame):
        raise InputError(f"{file}: no footprint is valid; the first one, {ids[0]!r}, {faults[0]}")
    good = np.flatnonzero(faults == "")
    notes = list[str]()
    if len(bad):
        notes = [f"{file}: {len(bad)} footprints are left out; the first one, {ids[bad[0]]!r}, {faults[bad[0]]}"]
    attributes = {name: _values(column)[good] for name, column in columns.items()}
    crs = None if frame.crs is None else checked_crs(frame.crs)
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
        raise InputError(f"{path.name}: unknown format of footprints; use one of {', '.join(SUFFIXES)}")
    try:
        if path.suffix.lower() == ".parquet":
            return geopandas.read_parquet(path), path.name
        return geopandas.read_file(path, engine="pyogrio", layer=_layer_of(path, layer)), path.name
    except InputError:
        raise
    except Exception as error:  # GDAL, pyarrow and geopandas raise many kinds of errors for damaged files
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"{path.name}: cannot be read ({reason}); is it a file of footprints?") from None


def _layer_of(path: Path, layer: str | None) -> str:
    """The layer of a file, by default the only one with polygons."""
    layers = import_extra("pyogrio", "footprints", "gis").list_layers(path)
    names = [str(name) for name, kind in layers if kind is not None]
    if layer is not None:
        if layer not in names:
            hint = spelling_hint(layer, names)
            raise InputError(f"{path.name}: has no layer {layer!r}; {hint}there are {', '.join(names)}")
        return layer
    polygons = [str(name) for name, kind in layers if kind is not None and "Point" not in kind and "Line" not in kind]
    if len(polygons) != 1:
        there = f"has the layers {', '.join(names)}" if names else "has no layers"
        raise InputError(f"{path.name}: {there}; name the one with footprints: layer=NAME, or FILE?layer=NAME")
    return polygons[0]


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


def _numbers(value: Any, what: str, columns: dict[str, Any], n: int, file: str) -> NDArray[np.float64]:
    """(n,) float64 from a number, an array or the name of a column; NaN: missing."""
    if not isinstance(value, str) and np.ndim(value) == 0 and is_number(value):
        return np.full(n, number(value, what))
    if not isinstance(value, str):
        values = as_array(value, what)
        if values.shape != (n,) or values.dtype.kind not in "fiu":
            raise InputError(f"{what} must be a column, a number, or {n} numbers, one per footprint")
        return values.astype(np.float64)
    pandas = import_extra("pandas", "footprints", "gis")
    if value not in columns:
        numeric = [name for name, column in columns.items() if column.dtype.kind in "fiu"]
        hint = spelling_hint(value, columns)
        there = f"columns of numbers: {', '.join(numeric[:_MOST_NAMES])}" if numeric else "it has no numbers"
        raise InputError(f"{file}: has no column {value!r} for {what}; {hint}{there}")
    column = pandas.to_numeric(columns[value], errors="coerce")
    numbers: NDArray[np.float64] = column.to_numpy(np.float64, na_value=np.nan)
    return numbers


def _values(column: Any) -> NDArray[Any]:
    """The numbers of a column, or its other values, with None where they are missing."""
    if column.dtype.kind in "fiu":
        return np.asarray(column)
    return np.asarray(column.astype(object).where(column.notna(), None), object)


def _ids(name: str | None, columns: dict[str, Any], frame: Any, file: str) -> list[str]:
    if name is not None and text(name, "id") not in columns:
        raise InputError(f"{file}: has no column {name!r} for id; {spelling_hint(name, columns)}it names footprints")
    name = next((each for each in _IDS if each in columns), None) if name is None else name
    return [str(each) for each in (frame.index if name is None else columns[name])]


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
    more = f" (and {len(bad) - 1} more footprints have faults)" if len(bad) > 1 else ""
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
