"""`load`: read a scene from a file or folder."""

import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast

from ..base.checks import byte_count, flag, quoted
from ..base.errors import InputError
from ..base.memory import reading_limit
from ..formats.example_files import scene_path
from ..formats.format_registry import GLB, GLTF, format_of
from ..formats.scene_format import ReadOptions
from ..scene.crs import checked_crs, in_one_unit
from ..scene.materials import Transmittance
from ..scene.scene_data import SceneData, group_notes
from ..scene.units import checked_unit
from .scene import AnyScene, Scene
from .scene_reading import read_scene_data

if TYPE_CHECKING:
    from .paged_scene import PagedScene

SceneLike: TypeAlias = "AnyScene | str | os.PathLike[str] | Any"
"""A scene argument: a scene, the path or example name of one, or a mesh or DataArray of another library, see `load`."""


def load(
    path: "str | os.PathLike[str] | Any",
    *,
    up: str | None = None,
    lod: str | None = None,
    cutouts: bool = True,
    transmittance: Mapping[str, Transmittance] | None = None,
    crs: str | None = None,
    unit: str | None = None,
    instances: bool | None = None,
    animation: str | None = None,
    max_memory: int | None = None,
) -> "Scene | PagedScene":
    """Read a scene from a file, or convert a mesh of another library.

    Parameters
    ----------
    path : str, path-like, or a mesh
        One of eight kinds:

        - A .glb, .gltf, .obj, .ply or .stl file. Files that it refers to are read from its folder only.
        - A CityJSON file (.json, .city.json) or CityJSONSeq file (.jsonl, .city.jsonl); requires antumbra[gis].
        - A raster of heights (.tif, .tiff, .vrt, .asc), as `antumbra.from_raster` reads it; requires antumbra[gis].
        - Footprints with heights (.gpkg, .geojson, .shp, .fgb, .parquet) in a column ``height``, as
          `antumbra.from_footprints` reads them; requires antumbra[gis].
        - A folder with `frames.npy`, the vertices at n times, (n, v, 3) float; `faces.npy`, (f, 3) int; and optionally
          `face_rgba.npy`, (f, 4) uint8 or float, linear, and an `info.json` with "times" (n seconds).
        - A store (.antumbra), or tiles (.tiles), built by `antumbra build`.
        - ``example:NAME``, a scene that comes with the package: `antumbra.examples` lists them.
        - A mesh of trimesh, pyvista, meshio or Open3D, see `Scene.from_mesh`; or a DataArray of heights of xarray, see
          `antumbra.from_raster`.

        The name of a GeoTIFF or a store may be a URL, of https, s3, gs or az. Only the chunks of a store that are
        needed are read; requires antumbra[cloud].
    up : "y" or "z", optional
        The axis that points up. It is recorded as `Scene.up`; coordinates are not changed. None: "z" for CityJSON,
        rasters, footprints and meshes of other libraries, and for other files whose floors and roofs face z, with a
        note; "y" for all other files. A store has its own axis.
    lod : str, optional
        Level of detail of CityJSON, such as "2.2". None: the highest of each object. Objects whose parts have a higher
        one, such as a Building with BuildingParts, are represented by these parts. Of several geometries of an object
        at the same place, one is read, a Solid before a MultiSurface; `Scene.notes` has the number of the others.
    cutouts : bool
        True: rays pass through the holes of faces whose material has alpha mode MASK, and some of the light through
        those with BLEND or KHR_materials_transmission; see `Scene.set_transmittance` for what it counts in. False: all
        faces are solid; a store with holes keeps them, and refuses it.
    transmittance : dict of str to float, three floats, or twelve of these, optional
        Shares of the light that materials or objects let pass, or those of each month, as for
        `Scene.set_transmittance`.
    crs : str, optional
        Coordinate reference system of the coordinates, such as "EPSG:28992", or anything that pyproj accepts. It is
        recorded as `Scene.crs`; tables and rasters carry it. None: that of the file, for CityJSON and stores.
    unit : str, optional
        Length unit of the coordinates: "mm", "cm", "dm", "m", "km", "in", "ft" or "us-ft". None: that of the CRS or
        of the store, else metres, which glTF prescribes, and which is assumed of all other files. It is recorded as
        `Scene.unit`; coordinates are not changed.
    instances : bool, optional
        For glTF, whether nodes that share a mesh, and the copies of EXT_mesh_gpu_instancing, stay instances: the scene
        takes memory for its meshes, not for their copies, and all answers are the same, bit by bit. Only the plan
        ``wide`` traces instances; others flatten the scene. Instances have one colour per face. None: if the copies
        would take more than 1 GiB, the scene is static and no material lets light pass.
    animation : str, optional
        For glTF, the name of the clip that plays, or its number if it has none. None: all play at once, and of those
        that move the same property of a node, the first.
    max_memory : int, optional
        Limit in bytes on the memory that reading takes. A file that would take more is refused before any is allocated.
        None: what is available, but at most 1 GiB or a hundred times the size of the file, whichever is larger. For a
        store, the limit on the memory of queries, see `PagedScene.max_memory`.

    Returns
    -------
    Scene or PagedScene
        For a store, a `PagedScene`, whose triangles stay on disk. `Scene.appearance` has materials, textures, vertex
        colours and normals; `Scene.colours` has the mean colour of each face. CityJSON is coloured by the types of its
        surfaces and objects, which are in `Scene.city`.

    Raises
    ------
    InputError
        If anything cannot be read. The one-line message names the file, the field and the remedy.

    Warns
    -----
    UserWarning
        Once for each kind of `Scene.notes` and with their number, such as missing textures or partly supported lights.

    Examples
    --------
    >>> temple = at.load("example:temple")
    >>> temple.bounds.round(1)
    array([[ -7.7,  -0. , -11. ],
           [  7.7,  11.8,  11. ]])
    """
    given_crs = None if crs is None else checked_crs(crs)
    if transmittance is not None and instances is None:
        instances = False
    length = None if unit is None else checked_unit(unit)
    if isinstance(path, (str, os.PathLike)):
        path = scene_path(path)
    if animation is not None and not (isinstance(path, Path) and format_of(path) in (GLB, GLTF)):
        raise InputError(f"{quoted(path)}: animation chooses a clip of a glTF file; leave it out")
    options = ReadOptions(up, lod, instances, flag(cutouts, "cutouts"), given_crs, length, animation)
    limit = None if max_memory is None else byte_count(max_memory, "max_memory", 1)
    with reading_limit(limit):
        scene = _scene_of_data(read_scene_data(path, options))
    if limit is not None and not scene.data.resident:
        cast("PagedScene", scene).max_memory = limit
    if not cutouts:
        scene.ignore_alpha()
    if transmittance is not None:
        scene.data.set_transmittance(transmittance)
    if given_crs is not None:
        converted = scene.crs is not None and scene.data.resident  # readers with a CRS convert heights
        scene.crs = in_one_unit(given_crs)[0] if converted else given_crs
    scene.data.unit = length or scene.data.given_unit
    for note in group_notes(scene.notes):
        warnings.warn(note, UserWarning, stacklevel=2)
    return scene


def scene_of(value: SceneLike, stacklevel: int = 3) -> "Scene | PagedScene":
    """The scene of a `SceneLike` argument, loaded if necessary. `stacklevel`: that of warnings.

    Raises
    ------
    InputError
        If it is not a scene, a path, or a mesh that `load` supports, or if it cannot be read.

    Warns
    -----
    UserWarning
        As `load` does.
    """
    if isinstance(value, AnyScene):
        return cast("Scene | PagedScene", value)  # there are no other subclasses
    scene = _scene_of_data(read_scene_data(value))
    for note in scene.notes:
        warnings.warn(note, UserWarning, stacklevel=stacklevel)
    return scene


def _scene_of_data(data: SceneData) -> "Scene | PagedScene":
    """The scene with this data."""
    if data.resident:
        return Scene.of_data(data)
    from .paged_scene import PagedScene  # imported late: scenes in memory start sooner without it

    return PagedScene.of_data(data)
