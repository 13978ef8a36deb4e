"""Reading a scene from a file or folder."""

import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from ..checks import flag, path_of, text
from ..errors import InputError
from ..scene.crs import checked_crs
from ..scene.files import checked_file
from ..scene.foreign import KNOWN, is_mesh
from ..scene.memory import checked_up
from ..scene.notes import by_kind
from ..scene.sampled import looks_z_up, sampled_faces
from ..scene.source import Source
from ..store.layout import STORE_SUFFIX
from .any_scene import AnyScene
from .scene import Scene

if TYPE_CHECKING:
    from .paged_scene import PagedScene

SceneLike: TypeAlias = "AnyScene | str | os.PathLike[str] | Any"
"""What functions take as a scene: a scene, the path of one, or a mesh of another library; see `load`."""

GLTF_SUFFIXES = (".glb", ".gltf")
MESH_SUFFIXES = (".obj", ".ply", ".stl")
CITY_SUFFIXES = (".json", ".jsonl")


def load(
    path, *, up: str | None = None, lod: str | None = None, cutouts: bool = True, crs: str | None = None
) -> "Scene | PagedScene":
    """Read a scene from a file, or take it from a mesh of another library.

    Parameters
    ----------
    path : str, path-like, or a mesh
        One of five kinds. A .glb, .gltf, .obj, .ply or .stl file; files that it names are read from its folder only.
        A CityJSON file, .json or .city.json, or a CityJSONSeq file, .jsonl or .city.jsonl; it needs antumbra[gis].
        A folder with `frames.npy` ((n, v, 3) float, the vertices at n moments) and `faces.npy` ((f, 3) int);
        `face_rgba.npy` ((f, 4) uint8 or float, linear) and an `info.json` with "times" (n seconds) are optional.
        A store, .antumbra, made by `antumbra build`. Or a mesh of trimesh, pyvista, meshio or Open3D, see
        `Scene.from_mesh`.
    up : "y" or "z", optional
        The axis that points up. It is recorded as `Scene.up`; coordinates are not changed. None: "z" for CityJSON, and
        for other files whose floors and roofs face z, with a note; "y" for the rest, and for meshes of other libraries.
        A store has its own axis.
    lod : str, optional
        Level of detail of CityJSON, such as "2.2". None: the highest of each object. An object whose parts have a
        higher one, such as a Building of BuildingParts, is left to these parts.
    cutouts : bool
        True: rays pass through faces where the alpha of their material says so, texel by texel. The alpha modes MASK
        and BLEND do; BLEND stops light from alpha 0.5 on. False: all faces are solid, as they are in stores.

    crs : str, optional
        Coordinate reference system of the coordinates, such as "EPSG:28992", or anything that pyproj accepts. It is
        recorded as `Scene.crs`; tables and rasters carry it. None: that of the file, which CityJSON and stores have.

    Returns
    -------
    Scene or PagedScene
        For a store a `PagedScene`, whose triangles stay on disk. `Scene.appearance` has materials, textures, colours
        of vertices and normals; `Scene.colours` has their mean colour of each face. CityJSON is coloured by the types
        of its surfaces and objects, and `Scene.city` names them.

    Raises
    ------
    InputError
        If anything cannot be read. The one-line message names the file, the field and the cure.

    Warns
    -----
    UserWarning
        Once for each kind of `Scene.notes`, such as missing textures or lights that are only partly supported, with
        their number.
    """
    asked = None if crs is None else checked_crs(crs)
    scene = _opened(path, up, lod)
    if not flag(cutouts, "cutouts") and isinstance(scene, Scene):
        scene.ignore_alpha()
    scene.crs = asked or scene.crs
    for note in by_kind(scene.notes):
        warnings.warn(note, UserWarning, stacklevel=2)
    return scene


def scene_of(value: SceneLike) -> "Scene | PagedScene":
    """The scene that a public function is given: a scene as it is, or what `load` reads.

    Raises
    ------
    InputError
        If it is neither a scene, nor a path, nor a mesh of a library that `load` knows, or cannot be read.

    Warns
    -----
    UserWarning
        As `load` does.
    """
    if isinstance(value, AnyScene):
        return value  # type: ignore[return-value]  # the two kinds that there are
    scene = _opened(value, None, None)
    for note in scene.notes:
        warnings.warn(note, UserWarning, stacklevel=3)
    return scene


def _opened(value, up: str | None, lod: str | None) -> "Scene | PagedScene":
    """The scene of a path or of a mesh of another library."""
    if up is not None:
        checked_up(up)
    if lod is not None:
        text(lod, "lod")
    if is_mesh(value):
        return Scene.from_mesh(value, up=up or "y")
    if isinstance(value, (str, os.PathLike)):
        return _scene_in(path_of(value, "scene"), up, lod)
    kind = type(value).__name__
    raise InputError(f"scene is a {kind}; give the path of a file, a scene, or {KNOWN}; arrays go to Scene.from_arrays")


def _scene_in(path: Path, up: str | None, lod: str | None) -> "Scene | PagedScene":
    """The scene of a file or folder; errors of libraries become an `InputError`."""
    try:
        with np.errstate(all="ignore"):
            return _read(path, up, lod)
    except InputError:
        raise
    except MemoryError as error:
        raise InputError(f"{path.name}: not enough memory for this scene; use a smaller one") from error
    except Exception as error:  # a library failed on input that passed all checks
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path.name}: cannot be read ({reason}); is the file damaged?") from error


def _read(path: Path, up: str | None, lod: str | None) -> "Scene | PagedScene":
    # Readers are imported on demand: importing trimesh alone takes longer than loading most scenes.
    name, suffix = path.name or str(path), path.suffix.lower()
    if suffix in CITY_SUFFIXES and not path.is_dir():
        return _read_city(path, name, up, lod)
    if lod is not None:
        raise InputError(f"{name}: lod is for CityJSON files; leave it out")
    if path.is_dir():
        from ..scene.frames import read_frames

        return _scene(*read_frames(path), path.resolve().name, up)
    if suffix == STORE_SUFFIX:
        from ..store.data import load_store
        from .paged_scene import PagedScene

        return PagedScene.of_data(load_store(path))
    if suffix not in GLTF_SUFFIXES + MESH_SUFFIXES:
        known = ", ".join((*GLTF_SUFFIXES, *MESH_SUFFIXES, *CITY_SUFFIXES, STORE_SUFFIX))
        checked_file(path, name)
        shown = f"format {suffix!r}" if suffix else "format, no suffix"
        raise InputError(f"{name}: unknown {shown}; use one of {known}, or a folder")
    checked_file(path, name)
    if suffix in GLTF_SUFFIXES:
        from ..scene.gltf import read_gltf

        return _scene(*read_gltf(path), path.stem, up)
    from ..scene.meshfile import read_mesh_file

    return _scene(*read_mesh_file(path), path.stem, up)


def _read_city(path: Path, name: str, up: str | None, lod: str | None) -> Scene:
    from ..scene.cityjson.read import read_cityjson

    checked_file(path, name)
    found = read_cityjson(path, lod)
    name, city = path.stem.removesuffix(".city"), found.city
    return Scene(found.source, name=name, up=up or "z", notes=tuple(found.notes), city=city, crs=city.crs)


def _scene(source: Source, notes: list[str], name: str, up: str | None) -> Scene:
    scene = Scene(source, name=name, up=up or "y", notes=tuple(notes))
    if up is None and looks_z_up(sampled_faces(source, scene.n_triangles)):
        scene.up, scene.notes = "z", (*scene.notes, f'{source.file}: looks as if z pointed up; up="y" says otherwise')
    return scene
