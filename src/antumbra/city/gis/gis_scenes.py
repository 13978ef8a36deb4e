"""`from_raster` and `from_footprints`: scenes of terrain and buildings from geographic data."""

import warnings
from typing import Any

from ...base.memory import reading_limit
from ...engine.scene import Scene
from ...scene.crs import checked_crs
from ...scene.scene_data import MemoryData, group_notes
from ...scene.units import checked_unit
from .footprint_table import FootprintOptions, FootprintsLike
from .gis_data import footprint_data, terrain_data
from .height_arrays import RasterLike, is_raster
from .height_files import HeightOptions


def from_raster(
    raster: "RasterLike | list[RasterLike]",
    *,
    ground: "RasterLike | list[RasterLike] | None" = None,
    values_at: str = "centres",
    nodata: float | None = None,
    z_scale: float | None = None,
    band: int | None = None,
    crs: str | None = None,
    unit: str | None = None,
    clip: tuple[float, float, float, float] | None = None,
    name: str | None = None,
    max_memory: int | None = None,
) -> Scene:
    """Triangulate a raster of heights, such as a digital elevation model (DEM). Z is up.

    The surface has a vertex at the centre of each cell. Four neighbouring vertices form a square, which the diagonal
    from its north-west to its south-east corner splits into two triangles. A triangle exists if its three cells have
    heights. The surface therefore ends at the centres of the outermost cells.

    Parameters
    ----------
    raster : str, path-like, DataArray, tuple, or list of these
        - A GeoTIFF, an ASCII grid (.asc), or a virtual raster (.vrt) of these in its folder. The name of a GeoTIFF may
          be a URL, of https, s3, gs or az, whose file is read by window.
        - A DataArray of xarray or rioxarray, with coordinates for its two dimensions, in either order: x and y, easting
          and northing, longitude and latitude, or any names with the axis or standard name of the CF conventions.
        - (array, transform) or (array, transform, crs): heights (rows, columns), where NaN and masked cells have no
          data; the affine transform of rasterio; and a CRS.
        - A list of tiles in one grid, which are joined without cracks. Where they overlap, the first one that has a
          height counts.
    ground : as `raster`, optional
        A second surface below the first, such as a terrain model (DTM) under a surface model (DSM), which shows through
        its holes. It has its own grid, in the same CRS.
    values_at : "centres" or "corners"
        Where in a cell its height is measured: at its centre, or at its north-west corner, as in grids whose transform
        points at the samples. DataArrays ignore it, since their coordinates are those of the heights.
    nodata : float, optional
        Cells with this number, as stored, have no data, in addition to those that the file marks.
    z_scale : float, optional
        Factor on the heights, after the scale and offset of the file. None: from the unit of the heights, which the
        file or else the vertical part of the CRS names, to that of the coordinates; 1 if it is unknown.
    band : int, optional
        Band of the file, from 1. None: the only one.
    crs : str, optional
        CRS of the coordinates, such as "EPSG:28992", instead of that of the raster.
    unit : str, optional
        Length unit of the coordinates: "mm", "cm", "dm", "m", "km", "in", "ft" or "us-ft". None: that of the CRS, or
        metres. See `Scene.unit`.
    clip : (4,) float, optional
        West, south, east and north of the part that is read. The surface covers it; what lies beyond casts no shadow.
        None: all cells.
    name : str, optional
        Name of the scene. None: that of the file or array.
    max_memory : int, optional
        Limit in bytes on the memory that reading takes, as for `antumbra.load`.

    Returns
    -------
    Scene
        Each surface is an object of the type "TINRelief". `Scene.raster` has the cells, in which the sensors
        ``raster`` lie.

    Raises
    ------
    InputError
        If the raster cannot be read, is rotated, has a CRS in degrees, or holds infinite or no heights; if tiles do not
        share a grid; or if two CRS differ.

    Warns
    -----
    UserWarning
        If cells hold -9999 or another common mark of missing data that the file does not declare; or if the unit of
        the heights is unknown and coordinates are not in metres.

    Notes
    -----
    Coordinates are computed in float64, recentred, and rounded once to float32. Answers are exact for that surface. A
    raster takes about 60 bytes per triangle, besides the trees of queries; `build_store` streams larger ones.
    """
    system = None if crs is None else checked_crs(crs)
    length = None if unit is None else checked_unit(unit)
    options = HeightOptions(band, nodata, z_scale, values_at, system, length, clip)
    with reading_limit(max_memory):
        data = terrain_data(raster, options, ground, name)
    return _scene(data)


def from_footprints(
    footprints: FootprintsLike,
    height: Any = None,
    base: Any = 0.0,
    *,
    terrain: Any = None,
    id: str | None = None,
    layer: str | None = None,
    invalid: str = "raise",
    crs: str | None = None,
    unit: str | None = None,
    name: str | None = None,
    max_memory: int | None = None,
) -> Scene:
    """Make buildings from footprints with heights: closed solids with a flat roof, walls and a floor. Z is up.

    Parameters
    ----------
    footprints : str, path-like, or GeoDataFrame
        Polygons and multipolygons, which may have holes: a GeoPackage, GeoJSON, shapefile, FlatGeobuf or GeoParquet
        file, or a GeoDataFrame of geopandas.
    height : str, float, or (n,) float, optional
        The height of each roof above the base, in the unit of the coordinates: a column, or numbers. None: the column
        ``height``. Columns of text may have the units of OpenStreetMap: "12 m", "40 ft", "5'3\"". A column whose name
        ends with ``levels`` counts storeys of 3 m.
    base : str, float, (n,) float, or a raster
        The height of each floor: a column, numbers, or a raster of heights in any form that `from_raster` takes. On a
        raster, a building stands on the lowest point of the surface under its footprint, and the surface is part of the
        scene. A text with a raster's suffix is a file.
    terrain : a raster, optional
        The same as a raster as `base`.
    id : str, optional
        The column that names the buildings. None: ``id``, ``identificatie``, ``gml_id``, ``osm_id`` or ``fid``, else
        the row.
    layer : str, optional
        The layer of the file. None: the only one with polygons.
    invalid : "raise" or "skip"
        Footprints that cross themselves, have no area, no height, or no terrain under them: an InputError that names
        the first one, or left out and counted in `Scene.notes`.
    crs : str, optional
        CRS of the scene. Footprints in degrees, such as GeoJSON, are projected to it; others must have it. None: that
        of the terrain or the footprints.
    unit : str, optional
        Length unit of the coordinates: "mm", "cm", "dm", "m", "km", "in", "ft" or "us-ft". None: that of the CRS, or
        metres. See `Scene.unit`.
    name : str, optional
        Name of the scene. None: that of the file.
    max_memory : int, optional
        Limit in bytes on the memory that reading takes, as for `antumbra.load`.

    Returns
    -------
    Scene
        Each building is an object of the type "Building", and the terrain one of the type "TINRelief". `Scene.city` has
        the surfaces: a "RoofSurface", a "WallSurface" for each edge and a "GroundSurface" per polygon; and
        ``Scene.city.object_attribute(column, faces)`` the columns of the table.

    Raises
    ------
    InputError
        If the file cannot be read, a column is missing, a footprint is invalid, a CRS is in degrees and none is given,
        or two CRS differ.

    Warns
    -----
    UserWarning
        If footprints are left out.

    Notes
    -----
    Corners on the line between their neighbours are dropped. Normals point outwards.
    """
    if terrain is None and is_raster(base):
        base, terrain = 0.0, base
    system = None if crs is None else checked_crs(crs)
    length = None if unit is None else checked_unit(unit)
    options = FootprintOptions(height, base, id, layer, invalid, system, length)
    with reading_limit(max_memory):
        data = footprint_data(footprints, options, terrain, name)
    return _scene(data)


def _scene(data: MemoryData) -> Scene:
    for note in group_notes(data.notes):
        warnings.warn(note, UserWarning, stacklevel=3)
    return Scene.of_data(data)
