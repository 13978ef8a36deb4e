"""Scene data of rasters of heights and of footprints: surfaces and solids with z up, a CRS, and the raster's cells."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...base.checks import choice, listed, number, quoted, text, whole_number
from ...base.errors import InputError
from ...base.memory import check_reading
from ...scene.crs import check_horizontal_crs
from ...scene.materials import srgb_to_linear
from ...scene.scene_data import MemoryData
from ...scene.terrain import HeightGrid, StreamedTerrain, TerrainSurfaces
from ...scene.units import LengthUnit, checked_unit
from .footprint_solids import on_terrain, solids_of
from .footprint_table import FootprintOptions, FootprintsLike, read_footprints
from .height_arrays import DataArrayHeights, RasterLike, height_grid, is_data_array
from .height_files import HeightFile, HeightOptions
from .height_tiles import TiledHeights

SURFACE = np.asarray(srgb_to_linear([0.839, 0.812, 0.714]), np.float32)
"""Linear colour of terrain, that of TINRelief in CityJSON."""

GROUND = np.asarray(srgb_to_linear([0.706, 0.643, 0.541]), np.float32)
"""Linear colour of the ground below a surface."""

_MANY = 50_000_000  # triangles
CELL_BYTES = 56.0
"""Memory of a cell with its triangles, while a scene is made."""


def checked_options(options: HeightOptions) -> HeightOptions:
    """Options with valid fields; otherwise an InputError."""
    if options.band is not None:
        whole_number(options.band, "band", 1, 1 << 16)
    if options.nodata is not None:
        number(options.nodata, "nodata", -np.inf, np.inf, "[]")
    if options.z_scale is not None and number(options.z_scale, "z_scale") == 0.0:
        raise InputError("z_scale is 0; give the factor from the unit of heights to that of the coordinates")
    choice(options.values_at, "values_at", ("centres", "corners"))
    if options.clip is not None:
        west, south, east, north = (number(each, "clip") for each in listed(options.clip, "clip", 4))
        if not (west < east and south < north):
            raise InputError(f"clip is {quoted(options.clip)}; give west, south, east, north, in this order")
        options = options._replace(clip=(west, south, east, north))
    return options


def terrain_data(
    raster: "RasterLike | Sequence[RasterLike]", options: HeightOptions, ground: Any = None, name: str | None = None
) -> MemoryData:
    """The data of a raster of heights, and of the ground below it, if given; `antumbra.from_raster` documents both."""
    options = checked_options(options)
    labelled = DataArrayHeights(raster, options) if is_data_array(raster) else None
    if labelled is not None:
        what = f"{labelled.name}: a scene of {labelled.n_cells:,} cells, unlike a store, which build_store streams,"
        check_reading(CELL_BYTES * labelled.n_cells, what)
    grid, notes = height_grid(raster, options) if labelled is None else labelled.whole()
    surfaces, colours = [grid], [SURFACE]
    if ground is not None:
        below, more = ground_grid(ground, grid.crs, options)
        surfaces, colours, notes = [grid, below], [SURFACE, GROUND], [*notes, *more]
    name = grid.name if name is None else text(name, "name")
    cells = sum(each.heights.size for each in surfaces)
    check_reading(CELL_BYTES * cells, f"{name}: a scene of {cells:,} cells")
    source = TerrainSurfaces(surfaces, name, colours)
    triangles = sum(mesh.triangles for mesh in source.meshes)
    if triangles > _MANY:
        store = "antumbra build makes a store of a raster, which takes little memory"
        notes = [*notes, f"{name}: {triangles:,} triangles take {triangles * 1e-7:.0f} GB or more; {store}"]
    data = MemoryData(source, name=name, up="z", notes=tuple(notes), crs=grid.crs, unit=options.unit)
    data.raster = grid.grid.raster(grid.crs)
    data.axes = None if labelled is None else labelled.axes
    return data


def ground_grid(ground: Any, crs: str | None, options: HeightOptions) -> tuple[HeightGrid, list[str]]:
    """The heights of a ground, whose CRS must be that of what stands on it."""
    of_ground = {name: getattr(options, name) for name in ("values_at", "crs", "unit", "clip")}
    grid, notes = height_grid(ground, HeightOptions(**of_ground))
    check_horizontal_crs(grid.name, grid.crs, crs)
    return grid, notes


def height_file(path: Path, keywords: dict[str, Any]) -> HeightFile:
    """A raster file of any size, with keywords of `antumbra.from_raster`."""
    unit = keywords.get("unit")
    return HeightFile(path, checked_options(HeightOptions(**keywords | {"unit": unit and checked_unit(unit)})))


def streamed_terrain(tiles: Sequence[tuple[Any, HeightOptions]]) -> StreamedTerrain:
    """Raster files and DataArrays, which are tiles of one surface, as a stream, for stores.

    Raises
    ------
    InputError
        If a file cannot be read, or tiles do not share a grid.
    """
    files = [_surface_of(tile, checked_options(options)) for tile, options in tiles]
    surface = files[0] if len(files) == 1 else TiledHeights(files)
    notes = lambda: [note for file in files for note in file.notes()]
    return StreamedTerrain(surface, notes, SURFACE, _unit_of(tiles))


def _surface_of(tile: Any, options: HeightOptions) -> DataArrayHeights | HeightFile:
    return DataArrayHeights(tile, options) if is_data_array(tile) else HeightFile(tile, options)


def _unit_of(tiles: Sequence[tuple[Any, HeightOptions]]) -> LengthUnit | None:
    """The unit given for tiles. InputError if they have different ones."""
    units = {options.unit for _, options in tiles}
    if len(units) > 1:
        raise InputError(f"{tiles[0][0].name}: tiles of one surface have the same unit; give it for all of them")
    return units.pop()


def footprint_data(
    table: FootprintsLike, options: FootprintOptions, terrain: Any = None, name: str | None = None
) -> MemoryData:
    """The data of buildings, and of the terrain on which they stand, if given.

    terrain : a raster of heights in any form, or None
    """
    grid, notes = None, list[str]()
    if terrain is not None:
        grid, notes = height_grid(terrain, HeightOptions(unit=options.unit))
        options = options._replace(base=None, crs=grid.crs if options.crs is None else options.crs)
    elif options.base is None:
        raise InputError("base is None; give a number, a column, or a raster of heights")
    footprints = read_footprints(table, options)
    if grid is not None:
        check_horizontal_crs(grid.name, grid.crs, footprints.crs)
        footprints = on_terrain(footprints, grid, options.invalid)
    source, city, more = solids_of(footprints, grid)
    if name is None:
        name = footprints.file.rpartition(".")[0] or "footprints"
    data = MemoryData(
        source, name=text(name, "name"), up="z", notes=(*notes, *more), city=city,
        crs=footprints.crs or (grid and grid.crs), unit=options.unit,
    )  # fmt: skip
    data.raster = None if grid is None else grid.grid.raster(grid.crs)
    return data
