"""The registry of scene file formats: how each is read and written, and what is lost.

Scene loading, exports, their error messages, the help of commands and ``antumbra formats`` derive from it. Readers and
writers are imported when called: importing trimesh alone takes longer than loading most scenes.
"""

import os
from collections.abc import Callable, Iterable
from functools import partial
from os import PathLike
from pathlib import Path
from typing import NamedTuple, TypeAlias, cast

import numpy as np

from ..base.files import checked_output
from ..base.memory import check_reading
from ..city.cityjson.cityjson_file import SUFFIXES as CITYJSON_SUFFIXES
from ..city.gis.footprint_table import SUFFIXES as FOOTPRINT_SUFFIXES
from ..city.gis.footprint_table import FootprintOptions
from ..city.gis.height_files import HeightOptions
from ..city.gis.raster_files import SUFFIXES as HEIGHT_SUFFIXES
from ..scene.crs import in_one_unit
from ..scene.instance_data import InstanceData, wants_instances
from ..scene.instances import InstancedSource
from ..scene.mesh import Source
from ..scene.palette_scene import PaletteScene
from ..scene.rounded_coordinates import rounding_notes
from ..scene.scene_bounds import guess_z_up, sampled_faces
from ..scene.scene_data import MemoryData, SceneData
from ..scene.units import LengthUnit


class ReadOptions(NamedTuple):
    """Options of reading a scene; `antumbra.load` documents them."""

    up: str | None = None  # the axis that points up; None: that of the format, or a guess
    lod: str | None = None  # level of detail
    instances: bool | None = None  # whether copies of meshes stay instances; None: if that saves much memory
    cutouts: bool = True  # False: all faces are solid
    crs: str | None = None  # instead of that of the file; to which footprints in degrees are projected
    unit: LengthUnit | None = None  # of the coordinates, if no CRS names it


Reader: TypeAlias = Callable[[Path, ReadOptions], SceneData]
"""(path, options) -> the data of a scene."""

Writer: TypeAlias = Callable[[PaletteScene, str, Path], list[Path]]
"""(scene, name of its mesh, path) -> the files written."""


class Format(NamedTuple):
    """A file format of scenes."""

    name: str  # in the list of formats
    suffixes: tuple[str, ...]  # in lower case; () for a folder
    read: Reader
    write: Writer | None  # None: scenes are not exported to this format
    extra: str | None  # of this package, which installs what some files or all need
    lost: str  # what reading or writing leaves out


_TALLEST = 2000.0  # metres: higher than any building

# --- Readers and writers ----------------------------------------------------------------------------------------------


_TRIANGLE_BYTES = 60  # of a scene in memory, without trees


def _data_of(source: Source, notes: list[str], name: str, options: ReadOptions) -> SceneData:
    """A scene whose up axis, unless given, is guessed from its faces."""
    scene: MemoryData | InstanceData
    up = options.up or "y"
    if wants_instances(source, options.instances, options.cutouts):
        scene = InstanceData(cast(InstancedSource, source), name=name, up=up, notes=tuple(notes))
        sample = scene.sampled_faces
    else:
        check_reading(_TRIANGLE_BYTES * sum(mesh.triangles * mesh.instances for mesh in source.meshes), source.file)
        scene = MemoryData(source, name=name, up=up, notes=tuple(notes))
        sample = partial(sampled_faces, source, scene.n_triangles)
    scene.notes = (*scene.notes, *rounding_notes(source.file, scene.bounds, sample))
    if options.up is None and guess_z_up(sample()):
        scene.up, scene.notes = "z", (*scene.notes, f'{source.file}: seems to have z up; pass up="y" to override')
    return scene


def _with_unit(scene: SceneData, file: str, options: ReadOptions) -> SceneData:
    """A scene of a format without units; a note, if none is given and a building is too high to be in metres."""
    height = float(np.ptp(scene.bounds, axis=0)["xyz".index(scene.up)])
    if options.unit is None and options.crs is None and height > _TALLEST:
        note = f'{file}: is {height:,.0f} m high, if its unit is the metre; pass its own, such as unit="mm"'
        scene.notes = (*scene.notes, note)
    return scene


def _read_gltf(path: Path, options: ReadOptions) -> SceneData:
    from .gltf.gltf_source import read_gltf

    return _data_of(*read_gltf(path), path.stem, options)


def _write_glb(scene: PaletteScene, name: str, path: Path) -> list[Path]:
    from .gltf.gltf_writer import write_glb

    return write_glb(scene, name, path)


def _read_mesh_file(path: Path, options: ReadOptions) -> SceneData:
    from .mesh_files import read_mesh_file

    return _with_unit(_data_of(*read_mesh_file(path), path.stem, options), path.name, options)


def _read_obj(path: Path, options: ReadOptions) -> SceneData:
    from .obj_file import read_obj

    return _with_unit(_data_of(*read_obj(path), path.stem, options), path.name, options)


def _write_obj(scene: PaletteScene, name: str, path: Path) -> list[Path]:
    from .obj_file import write_obj

    return write_obj(scene, name, path)


def _write_ply(scene: PaletteScene, name: str, path: Path) -> list[Path]:
    from .mesh_files import write_ply

    return write_ply(scene, path)


def _read_cityjson(path: Path, options: ReadOptions) -> SceneData:
    from ..city.cityjson.cityjson_source import read_cityjson

    source, notes, city = read_cityjson(path, options.lod, options.crs)
    name, crs = path.stem.removesuffix(".city"), options.crs or city.crs
    return MemoryData(
        source, name=name, up=options.up or "z", notes=tuple(notes), city=city,
        crs=None if crs is None else in_one_unit(crs)[0], unit=options.unit,
    )  # fmt: skip


def _read_heights(path: Path, options: ReadOptions) -> SceneData:
    from ..city.gis.gis_data import check_z_up, terrain_data

    check_z_up(options.up, path.name)
    return terrain_data(path, HeightOptions(crs=options.crs, unit=options.unit))


def _read_footprints(path: Path, options: ReadOptions) -> SceneData:
    from ..city.gis.gis_data import check_z_up, footprint_data

    check_z_up(options.up, path.name)
    return footprint_data(path, FootprintOptions(crs=options.crs, unit=options.unit))


def _read_frames(path: Path, options: ReadOptions) -> SceneData:
    from .array_files import read_frames

    return _data_of(*read_frames(path), path.resolve().name, options)


# --- The registry -----------------------------------------------------------------------------------------------------


_GLTF_LOST = "metalness, roughness, emission, normal maps, cones of spot lights, points and lines"
GLB = Format(
    "glTF 2.0, binary", (".glb",), _read_gltf, _write_glb, "compressed", f"{_GLTF_LOST}; when written: area lights"
)
GLTF = Format("glTF 2.0", (".gltf",), _read_gltf, None, "compressed", _GLTF_LOST)
OBJ = Format(
    "Wavefront OBJ",
    (".obj",),
    _read_obj,
    _write_obj,
    None,
    "all of materials but Kd, d, Tr, map_Kd and map_d; lines and curves; when written: cameras and lights",
)
PLY = Format(
    "PLY",
    (".ply",),
    _read_mesh_file,
    _write_ply,
    "meshes",
    "points and lines; when written: cameras, lights, and colours beyond 8 bits",
)
STL = Format("STL", (".stl",), _read_mesh_file, None, None, "colours")
CITYJSON = Format(
    "CityJSON, CityJSONSeq",
    CITYJSON_SUFFIXES,
    _read_cityjson,
    None,
    "gis",
    "points and lines, appearances, other levels of detail",
)
HEIGHTS = Format(
    "raster of heights",
    HEIGHT_SUFFIXES,
    _read_heights,
    None,
    "gis",
    "other bands, colour tables, cells without data (holes)",
)
FOOTPRINTS = Format(
    "footprints with heights",
    FOOTPRINT_SUFFIXES,
    _read_footprints,
    None,
    "gis",
    "points and lines, heights of vertices, other layers",
)
FRAMES = Format("folder of vertex frames", (), _read_frames, None, None, "alpha of face colours")

FORMATS = GLB, GLTF, OBJ, PLY, STL, CITYJSON, HEIGHTS, FOOTPRINTS, FRAMES
"""Formats of scenes in memory, in display order."""

SCENE_WRITERS = {suffix: each.write for each in FORMATS if each.write is not None for suffix in each.suffixes}
"""Suffix -> writer."""


def format_of(path: Path, formats: Iterable[Format] = FORMATS) -> Format | None:
    """The format of a path among `formats`, by its suffix in any case; for a folder, `FRAMES`; None if unknown."""
    if os.path.isdir(path):  # False for names that the system refuses
        return FRAMES
    suffix = path.suffix.lower()
    return next((each for each in formats if suffix in each.suffixes), None)


def check_output(path: str | PathLike[str]) -> Path:
    """`path` if a scene can be exported there; otherwise an InputError with a remedy."""
    output = checked_output(path, tuple(SCENE_WRITERS))
    if output.suffix.lower() in OBJ.suffixes:
        checked_output(output.with_suffix(".mtl"), (".mtl",))
    return output


def write_scene(scene: PaletteScene, name: str, path: str | PathLike[str]) -> list[Path]:
    """Export a scene to a file whose suffix, a key of `SCENE_WRITERS`, determines the format.

    Parameters
    ----------
    scene : PaletteScene
    name : str
        Name of the mesh.
    path : str or path-like

    Returns
    -------
    list of Path
        The files written: for OBJ also an .mtl file.

    Raises
    ------
    InputError
        If the suffix is unknown, or the file cannot be written.

    Notes
    -----
    GLB holds exact linear colours, the camera, and a point light at the centre of the scene's quad light (glTF has no
    area lights). OBJ and PLY hold triangles and colours, with 8 bits in PLY. Coordinates are float32 in GLB and PLY.
    """
    output = check_output(path)
    return SCENE_WRITERS[output.suffix.lower()](scene, name, output)
