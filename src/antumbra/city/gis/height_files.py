"""Rasters of heights in files that rasterio reads, such as GeoTIFF: their grid, CRS, units and holes.

`open_heights` reads rows when they are needed; `read_heights` reads them all. Heights are those of the file times its
scale plus its offset, in the unit of its coordinates.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.checks import quoted
from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.memory import check_reading
from ...formats.reprojection import WARP, projected_crs, warp_command
from ...scene.crs import checked_crs, in_one_unit, parts_of_crs, unit_of_crs
from ...scene.terrain import GridPoints, HeightGrid, HeightsByRow
from ...scene.units import METRE, LengthUnit, unit_named
from .raster_files import RasterFile

_SQUARE_TURN = 1e-9  # rotation of a raster, relative to its cells, that rounding explains
_MOST_CELLS = 1 << 30  # 2^31 triangles
_BAND = 256  # rows read at a time
_MASK_BYTES = 2  # per cell: masks of the file and of nodata
_EXACT = "float32", "int16", "uint16", "int8", "uint8"  # types whose values float32 represents
_NO_DATA = (-9999.0, -32768.0, -32767.0)  # common marks, which some files do not declare


class HeightOptions(NamedTuple):
    """How the numbers of a raster become heights; `antumbra.from_raster` documents the fields."""

    band: int | None = None
    nodata: float | None = None
    z_scale: float | None = None  # None: from the units of heights and coordinates
    values_at: str = "centres"  # or "corners"
    crs: str | None = None  # instead of that of the raster
    unit: LengthUnit | None = None  # of the coordinates, if no CRS names it
    clip: tuple[float, float, float, float] | None = None  # west, south, east and north of the part that is read


class GridPart(NamedTuple):
    """The points of a raster that are read, those around a clip."""

    grid: GridPoints
    rows: slice  # of the raster, from north to south
    columns: slice


def part_of(grid: GridPoints, clip: tuple[float, float, float, float] | None, where: str) -> GridPart:
    """The points whose surface covers a clip, as far as the raster goes; None: all points.

    Raises
    ------
    InputError
        If fewer than 2 x 2 points remain.
    """
    rows, columns = slice(0, grid.rows), slice(0, grid.columns)
    if clip is not None:
        low, high = grid.cells_of(np.array([[clip[0], clip[3]], [clip[2], clip[1]]]))
        (left, top), (right, bottom) = np.maximum(np.floor(low), 0.0), np.ceil(high) + 1.0
        columns, rows = slice(int(left), min(int(right), grid.columns)), slice(int(top), min(int(bottom), grid.rows))
    size = rows.stop - rows.start, columns.stop - columns.start
    if clip is not None and min(size) < 2:
        east, south = grid.eastings(grid.columns - 1)[0], grid.northings(grid.rows - 1)[0]
        extent = ",".join(f"{each:.10g}" for each in (grid.west, south, east, grid.north))
        raise InputError(f"{where}: clip lies beside its cells, which extend over {extent}; give W,S,E,N in its CRS")
    west = float(grid.eastings(columns.start, columns.start + 1)[0])
    north = float(grid.northings(rows.start, rows.start + 1)[0])
    return GridPart(grid._replace(west=west, north=north, rows=size[0], columns=size[1]), rows, columns)


def grid_of(place: Any, rows: int, columns: int, values_at: str, where: str) -> tuple[GridPoints, bool]:
    """The points of a raster, from its affine transform; and whether its row 0 is the southernmost.

    Raises
    ------
    InputError
        If the raster is rotated, has no extent, or is too small.
    """
    a, b, west, d, e, north = (float(each) for each in tuple(place)[:6])
    if not np.isfinite([a, b, west, d, e, north]).all() or max(abs(b), abs(d)) > _SQUARE_TURN * abs(a) or not a > 0.0:
        raise InputError(f"{where}: its rows do not run from west to east; warp it with: {WARP} FILE OUT.tif")
    if e == 0.0:
        raise InputError(f"{where}: its cells have no height; give them a georeference: gdal_edit.py -a_ullr ...")
    if rows < 2 or columns < 2:
        raise InputError(f"{where}: has {columns} x {rows} cells; a surface needs at least 2 x 2")
    shift = 0.5 if values_at == "centres" else 0.0
    first = north + e * shift if e < 0.0 else north + e * (rows - 1 + shift)
    return GridPoints(west + a * shift, first, a, abs(e), rows, columns), e > 0.0


def check_cells(grid: GridPoints, where: str) -> None:
    """Raise an InputError if triangles of a grid cannot be numbered in int32."""
    if grid.rows * grid.columns > _MOST_CELLS:
        cells = f"has {grid.rows * grid.columns:.2g} cells, more than {_MOST_CELLS:.2g}"
        raise InputError(f"{where}: {cells}; read a part: clip=(W, S, E, N), or FILE?clip=W,S,E,N")


def crs_of(crs: Any) -> Any:
    """A CRS of rasterio, from anything that it accepts; None for None."""
    if crs is None:
        return None
    rasterio = import_extra("rasterio", "crs", "gis")
    try:
        if isinstance(crs, str):  # GDAL would open the file or the address that it may name
            checked_crs(crs)
        return rasterio.CRS.from_user_input(crs)
    except (rasterio.errors.CRSError, TypeError, ValueError):  # an InputError is a ValueError
        raise InputError(f"crs {quoted(crs)} is unknown; write an EPSG code such as EPSG:28992") from None


def check_projected(crs: Any, where: str, grid: GridPoints) -> None:
    """Raise an InputError, with the command that projects the raster, if a CRS of rasterio is in degrees."""
    if crs is None or not parts_of_crs(text := crs.to_string()).plan.is_geographic:
        return
    longitude, latitude = grid.west + grid.dx * grid.columns / 2.0, grid.north - grid.dy * grid.rows / 2.0
    command = warp_command(projected_crs(text, longitude, latitude))
    raise InputError(f"{where}: its CRS, {text[:40]}, is in degrees; project it, for example with: {command}")


class HeightScale(NamedTuple):
    """How heights become those of the scene, in the unit of its plan."""

    factor: float
    crs: str | None  # of the scene: the plan of a compound CRS whose heights have another unit
    notes: list[str]


def height_scale(named: str | None, crs: Any, options: HeightOptions, where: str) -> HeightScale:
    """The factor from heights to the unit of the plan; 1 if either unit is unknown.

    named : the unit that the file names for its heights, which goes before that of the CRS; "" or None: none
    crs : a CRS of rasterio, or None
    """
    text = None if crs is None else crs.to_string()
    plan, parts = unit_of_crs(text, options.unit), None if text is None else parts_of_crs(text)
    system = None if text is None else in_one_unit(text)[0]
    if options.z_scale is not None:
        return HeightScale(options.z_scale, system, [])
    unit = unit_named(named or "")
    if unit is None and (named or "").strip():
        return HeightScale(1.0, system, [f"{where}: {_unknown(f'the unit of its heights, {quoted(named)}, is', plan)}"])
    unit = unit or (parts and parts.height_unit)
    if unit is None:
        sure = text is None or plan.same_as(METRE)
        return HeightScale(1.0, system, [] if sure else [f"{where}: {_unknown('the unit of its heights is', plan)}"])
    return HeightScale(1.0 if unit == plan else unit.metres / plan.metres, system, [])


def _unknown(what: str, plan: LengthUnit) -> str:
    return f"{what} unknown; they are taken in {plan.name}, the unit of the plan; if that is wrong, pass z_scale"


class HeightFile(HeightsByRow):
    """Heights in a file, read row by row.

    name : of the file, without suffix
    grid : the points of the heights
    crs : str, or None if the file has none
    unit : that of the coordinates, if it was given
    """

    def __init__(self, path: Path, options: HeightOptions):
        self.path, self.name, self.unit, self._nodata = path, path.stem, options.unit, options.nodata
        self._file = RasterFile(path)
        with self._file.open() as file:
            self._band = _band_of(file, options.band, path.name)
            system = file.crs if options.crs is None else crs_of(options.crs)
            if file.crs is None and file.transform.is_identity:
                raise InputError(f"{path.name}: has no georeference; write one: gdal_translate -a_ullr, -a_srs")
            whole, self._south_up = grid_of(file.transform, file.height, file.width, options.values_at, path.name)
            check_projected(system, path.name, whole)
            self.grid, self._part_rows, self._columns = part_of(whole, options.clip, path.name)
            self._rows = whole.rows
            k = self._band - 1
            scale, self.crs, self._unit_notes = height_scale(file.units[k], system, options, path.name)
            self._scale, self._offset = file.scales[k] * scale, file.offsets[k] * scale
            plain = (self._scale, self._offset) == (1.0, 0.0) and file.dtypes[k] in _EXACT
            self.dtype = np.dtype(np.float32 if plain else np.float64)
            self._is_masked = _is_masked(file, k)
            self._cell_bytes = 2 * self.dtype.itemsize + np.dtype(file.dtypes[k]).itemsize + _MASK_BYTES
        self._bands: dict[int, NDArray[Any]] = {}  # the last ones that were read, by number
        self._lowest = np.inf  # height read so far

    def rows(self, first: int, last: int) -> NDArray[Any]:
        """Heights of some rows, (last - first, columns) `dtype`, perhaps read-only; NaN: no data."""
        first, last = first + self._part_rows.start, last + self._part_rows.start
        if self._south_up:
            first, last = self._rows - last, self._rows - first
        size = self._cell_bytes * float(self.grid.columns) * (last - first)
        where = f"{self.path.name}: a raster of {self.grid.columns} x {self.grid.rows} cells"
        check_reading(size, where, self._file.stored)
        at = first
        with self._file.open() as file:
            part = self._band_rows(file, first // _BAND)
            if first % _BAND == 0 and len(part) == last - first:
                return part[::-1] if self._south_up else part
            heights = np.empty((last - first, self.grid.columns), self.dtype)
            while at < last:
                band = at // _BAND
                part = self._band_rows(file, band)[at - band * _BAND :][: last - at]
                if len(part) == len(heights):
                    heights = part
                    break
                heights[at - first : at - first + len(part)] = part
                at += len(part)
        return heights[::-1] if self._south_up else heights

    def _band_rows(self, file: Any, band: int) -> NDArray[Any]:
        """The heights of `_BAND` rows of the file.

        A virtual raster that averages its sources gives other values for other windows, so windows never depend on the
        rows that a caller wants; the last two are kept, since blocks of terrain share a row.
        """
        from rasterio.windows import Window

        if band not in self._bands:
            first, last = band * _BAND, min(band * _BAND + _BAND, self._rows)
            read = slice(0, file.width) if self._file.is_virtual else self._columns
            window = Window(read.start, first, read.stop - read.start, last - first)
            values = file.read(self._band, window=window, masked=self._is_masked)
            values = values[:, self._columns] if self._file.is_virtual else values
            heights = heights_of(values, self._nodata, self._scale, self._offset, self.dtype, copy=False)
            self._lowest = min(self._lowest, range_of(heights, self.path.name)[0])
            heights.flags.writeable = False
            self._bands = {**dict(list(self._bands.items())[-1:]), band: heights}
        return self._bands[band]

    def notes(self) -> list[str]:
        """Notes about the unit of the heights, and about the rows that have been read so far."""
        return [*self._unit_notes, *notes_of(self._lowest, self.path.name)]


def _band_of(file: Any, band: int | None, where: str) -> int:
    if band is None and file.count > 1:
        raise InputError(f"{where}: has {file.count} bands; name the one with the heights: band=1, or FILE?band=1")
    band = 1 if band is None else band
    if not 1 <= band <= file.count:
        raise InputError(f"{where}: has no band {band}; its bands are 1 to {file.count}")
    if np.dtype(file.dtypes[band - 1]).kind not in "fiu":
        raise InputError(f"{where}: band {band} holds {file.dtypes[band - 1]}; heights are integers or floats")
    return band


def _is_masked(file: Any, k: int) -> bool:
    """Whether cells of a band may be missing without being NaN."""
    flags = {flag.name for flag in file.mask_flag_enums[k]}
    mark = file.nodatavals[k]
    return not ("all_valid" in flags or (flags == {"nodata"} and mark is not None and np.isnan(mark)))


def heights_of(
    values: "np.ma.MaskedArray[Any, Any] | NDArray[Any]", nodata: float | None, scale: float, offset: float,
    dtype: np.dtype[Any], copy: bool = True,
) -> NDArray[Any]:  # fmt: skip
    """Numbers as heights: times a scale plus an offset, in a type; NaN where they are masked or equal `nodata`.

    copy : False: the numbers may be overwritten
    """
    data = np.ma.getdata(values)
    holes = np.ma.getmask(values)
    if nodata is not None:
        holes = holes | (data == nodata)
    heights = data.astype(dtype, copy=copy)
    if (scale, offset) != (1.0, 0.0):
        heights = heights * scale + offset
    if holes is not np.ma.nomask:
        heights[holes] = np.nan
    return heights


def read_heights(path: Path, options: HeightOptions) -> tuple[HeightGrid, list[str]]:
    """The heights of a file, and notes about them. Raises InputError if it cannot be read."""
    file = HeightFile(path, options)
    check_cells(file.grid, path.name)
    heights = np.require(file.rows(0, file.grid.rows), requirements=["C", "W"])
    grid, _ = checked_heights(HeightGrid(file.name, file.grid, file.crs, heights), path.name)
    return grid, file.notes()


def checked_heights(grid: HeightGrid, where: str) -> tuple[HeightGrid, list[str]]:
    """Heights, and notes about them. Raises InputError if they are infinite, or all missing."""
    lowest, highest = range_of(grid.heights, where)
    if lowest > highest:
        raise InputError(f"{where}: no cell has a height; check nodata and the band")
    return grid, notes_of(lowest, where)


def extremes(heights: NDArray[Any]) -> tuple[float, float]:
    """The lowest and the highest of some heights; NaN if all are missing."""
    lowest, highest = float(heights.min()), float(heights.max())
    if np.isnan(lowest):  # four times slower
        lowest, highest = float(np.fmin.reduce(heights, None)), float(np.fmax.reduce(heights, None))
    return lowest, highest


def range_of(heights: NDArray[Any], where: str) -> tuple[float, float]:
    """The lowest and the highest of some heights; inf and -inf if all are missing. InputError if any are infinite."""
    lowest, highest = extremes(heights)
    if np.isinf(lowest) or np.isinf(highest):
        raise InputError(f"{where}: has infinite heights; declare them as nodata: nodata=float('inf')")
    return (np.inf, -np.inf) if np.isnan(lowest) else (lowest, highest)


def notes_of(lowest: float, where: str) -> list[str]:
    """A note if the lowest height is a common mark of missing data."""
    if lowest in _NO_DATA:
        return [f"{where}: its lowest height is {lowest:g}; if that means no data, pass nodata={lowest:g}"]
    return []
