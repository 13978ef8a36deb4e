"""Rasters of heights in files that rasterio reads, such as GeoTIFF: their grid, CRS, units and holes.

`open_heights` reads rows when they are needed; `read_heights` reads them all. Heights are those of the file times its
scale plus its offset, in the unit of its coordinates.
"""

import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...checks import quoted
from ...errors import InputError
from ...extras import import_extra
from ...memory import check_reading
from ...scene.crs import checked_crs
from ...scene.terrain import GridPoints, HeightGrid
from .raster_files import RasterFile

METRES = {
    "m": 1.0,
    "metre": 1.0,
    "meter": 1.0,
    "metres": 1.0,
    "meters": 1.0,
    "cm": 0.01,
    "km": 1000.0,
    "ft": 0.3048,
    "foot": 0.3048,
    "feet": 0.3048,
    "international foot": 0.3048,
    "us-ft": 1200.0 / 3937.0,
    "ftus": 1200.0 / 3937.0,
    "us survey foot": 1200.0 / 3937.0,
}
"""Unit of heights, in lower case -> metres."""

_SQUARE_TURN = 1e-9  # rotation of a raster, relative to its cells, that rounding explains
_MOST_CELLS = 1 << 30  # 2^31 triangles
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


def grid_of(place: Any, rows: int, columns: int, values_at: str, where: str) -> tuple[GridPoints, bool]:
    """The points of a raster, from its affine transform; and whether its row 0 is the southernmost.

    Raises
    ------
    InputError
        If the raster is rotated, has no extent, or is too small or too large.
    """
    a, b, west, d, e, north = (float(each) for each in tuple(place)[:6])
    if not np.isfinite([a, b, west, d, e, north]).all() or max(abs(b), abs(d)) > _SQUARE_TURN * abs(a) or not a > 0.0:
        raise InputError(f"{where}: its rows do not run from west to east; warp it with: gdalwarp FILE NORTH_UP.tif")
    if e == 0.0:
        raise InputError(f"{where}: its cells have no height; give them a georeference: gdal_edit.py -a_ullr ...")
    if rows < 2 or columns < 2:
        raise InputError(f"{where}: has {columns} x {rows} cells; a surface needs at least 2 x 2")
    if rows * columns > _MOST_CELLS:
        raise InputError(f"{where}: has {rows * columns:.2g} cells, more than {_MOST_CELLS:.2g}; cut it")
    shift = 0.5 if values_at == "centres" else 0.0
    first = north + e * shift if e < 0.0 else north + e * (rows - 1 + shift)
    return GridPoints(west + a * shift, first, a, abs(e), rows, columns), e > 0.0


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
    """Raise an InputError if a CRS of rasterio is in degrees. The message names the UTM zone of the grid's centre."""
    if crs is None or not crs.is_geographic:
        return
    longitude, latitude = grid.west + grid.dx * grid.columns / 2.0, grid.north - grid.dy * grid.rows / 2.0
    zone = min(max(int((longitude + 180.0) // 6.0) + 1, 1), 60)
    code = (32600 if latitude >= 0.0 else 32700) + zone
    raise InputError(
        f"{where}: its CRS, {crs.to_string()[:40]}, is in degrees; project it, for example to UTM zone {zone}: "
        f"gdalwarp -t_srs EPSG:{code} -r bilinear FILE OUT.tif"
    )


def unit_scale(unit: str | None, crs: Any) -> float:
    """The factor from a unit of heights to the unit of a CRS of rasterio; 1 if either is unknown."""
    metres = METRES.get((unit or "").strip().lower())
    if metres is None:
        return 1.0
    horizontal = crs.linear_units_factor[1] if crs is not None and crs.is_projected else 1.0
    return 1.0 if metres == horizontal else metres / horizontal


class HeightFile:
    """Heights in a file, read row by row.

    name : of the file, without suffix
    grid : the points of the heights
    crs : str, or None if the file has none
    """

    def __init__(self, path: Path, options: HeightOptions):
        self.path, self.name, self._nodata = path, path.stem, options.nodata
        self._file = RasterFile(path)
        with self._file.open() as file:
            self._band = _band_of(file, options.band, path.name)
            system = file.crs if options.crs is None else crs_of(options.crs)
            if file.crs is None and file.transform.is_identity:
                raise InputError(f"{path.name}: has no georeference; write one: gdal_translate -a_ullr, -a_srs")
            self.grid, self._south_up = grid_of(file.transform, file.height, file.width, options.values_at, path.name)
            check_projected(system, path.name, self.grid)
            self.crs = system.to_string() if system else None
            k = self._band - 1
            scale = options.z_scale
            scale = unit_scale(file.units[k], system) if scale is None else scale
            self._scale, self._offset = file.scales[k] * scale, file.offsets[k] * scale
            plain = (self._scale, self._offset) == (1.0, 0.0) and file.dtypes[k] in _EXACT
            self.dtype = np.dtype(np.float32 if plain else np.float64)
            self._cell_bytes = 2 * self.dtype.itemsize + np.dtype(file.dtypes[k]).itemsize + _MASK_BYTES

    def rows(self, first: int, last: int) -> NDArray[Any]:
        """Heights of some rows, (last - first, columns) `dtype`; NaN: no data."""
        from rasterio.windows import Window

        if self._south_up:
            first, last = self.grid.rows - last, self.grid.rows - first
        size = self._cell_bytes * float(self.grid.columns) * (last - first)
        check_reading(
            size, f"{self.path.name}: a raster of {self.grid.columns} x {self.grid.rows} cells", self._file.stored
        )
        with self._file.open() as file:
            values = file.read(self._band, window=Window(0, first, self.grid.columns, last - first), masked=True)
        heights = heights_of(values, self._nodata, self._scale, self._offset, self.dtype)
        return heights[::-1] if self._south_up else heights


def _band_of(file: Any, band: int | None, where: str) -> int:
    if band is None and file.count > 1:
        raise InputError(f"{where}: has {file.count} bands; name the one with the heights: band=1, or FILE?band=1")
    band = 1 if band is None else band
    if not 1 <= band <= file.count:
        raise InputError(f"{where}: has no band {band}; its bands are 1 to {file.count}")
    if np.dtype(file.dtypes[band - 1]).kind not in "fiu":
        raise InputError(f"{where}: band {band} holds {file.dtypes[band - 1]}; heights are integers or floats")
    return band


def heights_of(
    values: "np.ma.MaskedArray[Any, Any] | NDArray[Any]", nodata: float | None, scale: float, offset: float,
    dtype: np.dtype[Any],
) -> NDArray[Any]:  # fmt: skip
    """Numbers as heights: times a scale plus an offset, in a type; NaN where they are masked or equal `nodata`."""
    data = np.ma.getdata(values)
    holes = np.ma.getmaskarray(values)
    if nodata is not None:
        holes = holes | (data == nodata)
    heights = data.astype(dtype)
    if (scale, offset) != (1.0, 0.0):
        heights = heights * scale + offset
    heights[holes] = np.nan
    return heights


def read_heights(path: Path, options: HeightOptions) -> tuple[HeightGrid, list[str]]:
    """The heights of a file, and notes about them. Raises InputError if it cannot be read."""
    file = HeightFile(path, options)
    heights = np.ascontiguousarray(file.rows(0, file.grid.rows))
    return checked_heights(HeightGrid(file.name, file.grid, file.crs, heights), path.name)


def checked_heights(grid: HeightGrid, where: str) -> tuple[HeightGrid, list[str]]:
    """Heights, and notes about them. Raises InputError if they are infinite, or all missing."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of nothing but holes
        lowest, highest = float(np.nanmin(grid.heights)), float(np.nanmax(grid.heights))
    if np.isnan(lowest):
        raise InputError(f"{where}: no cell has a height; check nodata and the band")
    if np.isinf(lowest) or np.isinf(highest):
        raise InputError(f"{where}: has infinite heights; declare them as nodata: nodata=float('inf')")
    if lowest in _NO_DATA:
        return grid, [f"{where}: its lowest height is {lowest:g}; if that means no data, pass nodata={lowest:g}"]
    return grid, []
