"""Plants with heights and radii: read from point or polygon layers and CSV files, and checked.

A point is the foot of a trunk. A polygon is the outline of a crown: the plant stands at its centroid, and its radius is
that of a circle with the same area.
"""

import csv
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.checks import choice, is_number, number, parts_of, path_of, quoted
from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.files import checked_file
from ...base.wording import agreeing, counted, some_of
from ...formats.foreign_formats import cure_of
from ...formats.reprojection import projected_crs, vector_command
from ...scene.crs import check_horizontal_crs, checked_crs, reproject, unit_of_crs
from ...scene.materials import MONTHS
from ...scene.units import LengthUnit
from ..gis.csv_rows import check_fields, check_header
from ..gis.length_texts import LENGTH_FORMS, lengths_in
from ..gis.vector_table import MOST_NAMES, NamedRows, given_numbers, id_column, read_layer
from .crowns import SHAPES, CrownShapes

SUFFIXES = (".gpkg", ".geojson", ".shp", ".fgb", ".parquet", ".csv")
"""Suffixes of files of plants."""

VegetationLike: TypeAlias = "str | PathLike[str] | Any"
"""Plants: a path, or a GeoDataFrame of geopandas."""

_IDS = "id", "gml_id", "osm_id", "fid"  # columns that name plants, in this order
_SLIMNESS = 60.0  # default height of a plant in radii of its trunk
_CLEAR = 0.25  # default height of the lowest part of a crown, as a share of the plant's height
_POINT = 0  # geometry type of shapely


class VegetationOptions(NamedTuple):
    """How rows become plants; `antumbra.from_trees` documents the fields."""

    height: Any = "height"
    radius: Any = None
    transmittance: Any = 0.0
    shape: str = "ellipsoid"
    base: Any = None
    crown_base: Any = None
    trunk_radius: Any = None
    id: str | None = None
    layer: str | None = None
    crs: str | None = None
    unit: LengthUnit | None = None  # of the coordinates, if no CRS names it


class Plants(NamedTuple):
    """Plants, whose lengths are in the unit of the coordinates."""

    file: str  # name in errors
    ids: list[str]
    plan: NDArray[np.float64]  # (n, 2) easting and northing of the trunks
    bases: NDArray[np.float64] | None  # (n,) height of the feet of the trunks; None: that of the surface there
    shapes: CrownShapes
    crs: str | None


class _PlantRows(NamedTuple):
    """The rows of a file or GeoDataFrame."""

    file: str
    plan: NDArray[np.float64]  # (n, 2); NaN: no place
    areas: NDArray[np.float64] | None  # (n,) of the outlines; None: the layer has points
    columns: dict[str, NDArray[Any]]  # (n,) each
    crs: str | None
    unit: LengthUnit | None = None  # of the coordinates, if no CRS names it

    @property
    def names(self) -> NamedRows:
        return NamedRows(self.file, "tree", len(self.plan))

    @property
    def metres(self) -> float:
        """Metres per unit of the coordinates."""
        return unit_of_crs(self.crs, self.unit).metres


def read_vegetation(table: VegetationLike, options: VegetationOptions, crs: str | None = None) -> Plants:
    """The plants of a file or GeoDataFrame, in the CRS of a scene if that is given.

    Raises
    ------
    InputError
        If the table cannot be read, a column is missing, a number is out of range, or a CRS differs or is in degrees.
    """
    choice(options.shape, "shape", SHAPES)
    rows = _projected(_table_of(table, options.layer), options.crs, crs)._replace(unit=options.unit)
    n, file = len(rows.plan), rows.file
    if not n:
        raise InputError(f"{file}: has no trees")
    heights = _numbers(options.height, "height", rows)
    clear = _CLEAR * heights if options.crown_base is None else _numbers(options.crown_base, "crown_base", rows)
    stems = (
        heights / _SLIMNESS if options.trunk_radius is None else _numbers(options.trunk_radius, "trunk_radius", rows)
    )
    bases = None if options.base is None else _numbers(options.base, "base", rows)
    shapes = CrownShapes(heights, _radii(options.radius, rows), clear, stems, _shares(options.transmittance, rows),
                        options.shape)  # fmt: skip
    ids = _ids(options.id, rows)
    faults = _faults(rows.plan, bases, shapes)
    bad = np.flatnonzero(faults != "")
    if len(bad):
        more = f" (and {counted(len(bad) - 1, 'more tree', 'have')} faults)" if len(bad) > 1 else ""
        raise InputError(f"{file}: tree {ids[bad[0]]!r} {faults[bad[0]]}{more}; correct it, or leave it out")
    return Plants(file, ids, rows.plan, bases, shapes, rows.crs)


# --- Files and tables -------------------------------------------------------------------------------------------------


def _table_of(table: VegetationLike, layer: str | None) -> _PlantRows:
    if isinstance(table, (str, PathLike)):
        path = checked_vegetation_file(table)
        return (
            _csv_table(path)
            if path.suffix.lower() == ".csv"
            else _frame_table(read_layer(path, layer, "trees", bool), path.name)
        )
    if type(table).__name__ == "GeoDataFrame":
        return _frame_table(table, "the trees")
    raise InputError(f"trees are {quoted(table)}; give the path of a file, or a GeoDataFrame")


def checked_vegetation_file(table: str | PathLike[str]) -> Path:
    """The path of a file that may hold plants, by its suffix; otherwise an InputError."""
    path = path_of(table, "trees")
    if path.suffix.lower() not in SUFFIXES:
        cure = cure_of(path) or f"unknown format of trees; use one of {', '.join(SUFFIXES)}"
        raise InputError(f"{path.name}: {cure}")
    return checked_file(path, path.name)


def _csv_table(path: Path) -> _PlantRows:
    """Plants of a CSV file with the columns x and y, in the coordinates of the scene."""
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            names, lines = list(reader.fieldnames or ()), list[dict[str, str]]()
            for line in reader:
                more = line.pop(None, ())  # fields beyond the header
                check_fields(len(names) + len(more), len(names), reader.line_num, path.name)
                lines.append(line)
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path.name}: cannot be read ({error}); save it as CSV in UTF-8") from None
    check_header(names, path.name)
    if not {"x", "y"} <= set(names):
        raise InputError(f"{path.name}: has no columns x and y; there are {', '.join(names[:MOST_NAMES]) or 'none'}")
    columns = {name: _column([line[name] or "" for line in lines]) for name in names}
    plan = [columns[axis] if columns[axis].dtype.kind == "f" else np.full(len(lines), np.nan) for axis in "xy"]
    return _PlantRows(path.name, np.stack(plan, 1), None, columns, None)


def _column(texts: list[str]) -> NDArray[Any]:
    """Numbers, NaN where a field is empty; or the texts, if one of them is no number."""
    try:
        return np.array([float(each) if each.strip() else np.nan for each in texts], np.float64)
    except ValueError:
        return np.array(texts, object)


def _frame_table(frame: Any, file: str) -> _PlantRows:
    """The places and columns of a GeoDataFrame of points or polygons."""
    shapely = import_extra("shapely", "trees", "gis")
    shapes = np.asarray(frame.geometry.array, object)
    points = shapely.get_type_id(shapes) == _POINT
    there = ~(shapely.is_missing(shapes) | shapely.is_empty(shapes))
    if (points & there).any() and (~points & there).any():
        raise InputError(f"{file}: has both points and outlines; give trees of one kind, in a layer each")
    centres = shapely.centroid(shapes)
    plan = np.stack([shapely.get_x(centres), shapely.get_y(centres)], 1)
    columns = {str(name): np.asarray(frame[name]) for name in frame.columns if name != frame.geometry.name}
    areas = None if points.any() or not there.any() else np.asarray(shapely.area(shapes), np.float64)
    return _PlantRows(file, plan, areas, columns, None if frame.crs is None else checked_crs(frame.crs))


def _projected(rows: _PlantRows, given: str | None, scene: str | None) -> _PlantRows:
    """Rows in the CRS of the scene. Points in degrees are projected; outlines in degrees have no area."""
    target = scene or given
    if given is not None:
        check_horizontal_crs(rows.file, checked_crs(given), scene)
    if rows.crs is None:
        return rows._replace(crs=target)
    if not import_extra("pyproj", "crs", "gis").CRS.from_user_input(rows.crs).is_geographic:
        check_horizontal_crs(rows.file, rows.crs, target)
        return rows
    if target is None:
        known = rows.plan[np.isfinite(rows.plan).all(1)]
        guess = projected_crs(rows.crs, *known.mean(0)) if len(known) else "EPSG:28992"
        raise InputError(f"{rows.file}: its CRS, {rows.crs[:40]}, is in degrees; name one in metres: crs={guess!r}")
    if rows.areas is not None:
        raise InputError(f"{rows.file}: outlines in degrees have no area; project them with: {vector_command(target)}")
    return rows._replace(plan=reproject(rows.plan, rows.crs, target), crs=target)


# --- Columns ----------------------------------------------------------------------------------------------------------


def _numbers(value: Any, what: str, rows: _PlantRows) -> NDArray[np.float64]:
    """(n,) float64 from a number, an array or the name of a column; NaN: missing."""
    numbers = given_numbers(value, what, rows.columns, rows.names)
    if numbers is not None:
        return numbers
    lengths, unread = lengths_in(rows.columns[value], rows.metres)
    bad = [text for text in unread.tolist() if text is not None]
    if bad:
        raise InputError(
            f"{rows.file}: {some_of(len(bad), len(unread), 'row')} of the column {value!r} for {what} "
            f"{agreeing(len(bad), 'lack')} a number, such as {bad[0][:20]!r}; write {LENGTH_FORMS}"
        )
    return lengths


def _radii(radius: Any, rows: _PlantRows) -> NDArray[np.float64]:
    """(n,) float64: radii of crowns; by default the column ``radius``, or those of the outlines."""
    if radius is None and rows.areas is not None:
        return np.sqrt(rows.areas / np.pi)
    return _numbers("radius" if radius is None else radius, "radius", rows)


def _shares(value: Any, rows: _PlantRows) -> NDArray[np.float64]:
    """(n, 12, 3) float64: the shares of red, green and blue light that each crown lets pass in each month."""
    n, parts = len(rows.plan), None if isinstance(value, str) else parts_of(value)
    if isinstance(value, str) or (isinstance(value, np.ndarray) and value.shape == (n,) and n not in (3, len(MONTHS))):
        grey = _numbers(value, "transmittance", rows)
        return np.broadcast_to(grey[:, None, None], (n, len(MONTHS), 3))
    months = parts if parts is not None and len(parts) == len(MONTHS) else [value] * len(MONTHS)
    shares = np.empty((len(MONTHS), 3))
    for month, share in zip(shares, months):
        colours = [share] * 3 if (each := parts_of(share)) is None else each
        if len(colours) != 3 or not all(is_number(colour) for colour in colours):
            forms = "a column, a share, shares of red, green and blue, or one of these per month"
            raise InputError(f"transmittance is {quoted(value)}; give {forms}")
        month[:] = [number(colour, "transmittance") for colour in colours]
    return np.broadcast_to(shares, (n, len(MONTHS), 3))


def _ids(name: str | None, rows: _PlantRows) -> list[str]:
    name = id_column(name, rows.columns, _IDS, rows.names)
    if name is None:
        return [f"tree {k}" for k in range(len(rows.plan))]
    return [f"{each:g}" if isinstance(each, float) else str(each) for each in rows.columns[name].tolist()]


def _faults(plan: np.ndarray, bases: np.ndarray | None, shapes: CrownShapes) -> NDArray[np.str_]:
    """(n,) str: why a row cannot become a plant; "": it can."""
    faults = np.full(len(plan), "", dtype="U100")
    faults[(shapes.trunk_radii < 0.0) | (shapes.trunk_radii > shapes.radii)] = "has a trunk wider than its crown"
    faults[(shapes.clear < 0.0) | (shapes.clear >= shapes.heights)] = "has a crown_base outside 0 to its height"
    shares = shapes.shares
    faults[~((shares >= 0.0) & (shares <= 1.0)).all((1, 2))] = "has a transmittance outside 0 to 1"
    lengths = {"height": shapes.heights, "radius": shapes.radii}
    for what, values in lengths.items():
        faults[~(values > 0.0)] = f"has a {what} of 0 or less, or none"
    others = [shapes.clear, shapes.trunk_radii, *lengths.values(), *([] if bases is None else [bases])]
    for values in others:
        faults[~np.isfinite(values) & (faults == "")] = "has a number that is missing or infinite"
    faults[~np.isfinite(plan).all(1)] = "has no place"
    return faults
