"""The file formats of cities: CityJSON, rasters of heights, and footprints. `formats.format_registry` lists them."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..formats.reprojection import city_command, vector_command, warp_command
from ..formats.scene_format import Contents, Format, ReadOptions, Tile, check_z_up
from ..scene.crs import in_one_unit
from ..scene.scene_data import MemoryData, SceneData
from ..scene.streamed_data import StreamedData
from .cityjson.cityjson_file import SUFFIXES as CITYJSON_SUFFIXES
from .gis.footprint_table import SUFFIXES as FOOTPRINT_SUFFIXES
from .gis.footprint_table import FootprintOptions
from .gis.height_arrays import is_data_array
from .gis.height_files import HeightOptions
from .gis.raster_files import SUFFIXES as HEIGHT_SUFFIXES

if TYPE_CHECKING:
    from ..scene.terrain import StreamedTerrain


def _read_cityjson(path: Path, options: ReadOptions) -> SceneData:
    from .cityjson.cityjson_source import read_cityjson, stream_cityjson

    name = path.stem.removesuffix(".city")
    if options.streamed and path.suffix.lower() == ".jsonl":
        staged, notes, crs = stream_cityjson(path, options.lod, options.crs)
        data = StreamedData(staged, name=name, up=options.up or "z", notes=tuple(notes))
        crs = options.crs or crs
        data.lacks_surfaces = True
        data.crs, data.unit = None if crs is None else in_one_unit(crs)[0], options.unit
        return data
    source, notes, city = read_cityjson(path, options.lod, options.crs)
    crs = options.crs or city.crs
    return MemoryData(
        source, name=name, up=options.up or "z", notes=tuple(notes), city=city,
        crs=None if crs is None else in_one_unit(crs)[0], unit=options.unit,
    )  # fmt: skip


def _read_heights(raster: Any, options: ReadOptions) -> SceneData:
    from .gis.gis_data import terrain_data

    check_z_up(options.up, str(raster.name))
    return terrain_data(raster, HeightOptions(crs=options.crs, unit=options.unit))


def _stream_heights(tiles: Sequence[Tile]) -> "StreamedTerrain":
    from .gis.gis_data import streamed_terrain

    rasters = list[tuple[Any, HeightOptions]]()
    for raster, given in tiles:
        check_z_up(given.get("up"), str(raster.name))
        rasters.append((raster, HeightOptions(**{name: value for name, value in given.items() if name != "up"})))
    return streamed_terrain(rasters)


def _read_footprints(path: Path, options: ReadOptions) -> SceneData:
    from .gis.gis_data import footprint_data

    check_z_up(options.up, path.name)
    return footprint_data(path, FootprintOptions(crs=options.crs, unit=options.unit))


CITYJSON = Format(
    "CityJSON, CityJSONSeq", CITYJSON_SUFFIXES, _read_cityjson, None, "gis",
    "points and lines, appearances, other levels of detail", Contents.CITY,
    reproject=lambda target, has_crs: city_command(target, "" if has_crs else "EPSG_CODE"),
)  # fmt: skip
HEIGHTS = Format(
    "raster of heights", HEIGHT_SUFFIXES, _read_heights, None, "gis",
    "other bands, colour tables, cells without data (holes)", Contents.HEIGHTS,
    stream=_stream_heights, reproject=lambda target, has_crs: warp_command(target), takes=is_data_array, by_url=True,
)  # fmt: skip
FOOTPRINTS = Format(
    "footprints with heights", FOOTPRINT_SUFFIXES, _read_footprints, None, "gis",
    "points and lines, heights of vertices, other layers", Contents.FOOTPRINTS,
    reproject=lambda target, has_crs: vector_command(target),
)  # fmt: skip
FORMATS = CITYJSON, HEIGHTS, FOOTPRINTS
