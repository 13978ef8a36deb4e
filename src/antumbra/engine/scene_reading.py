"""Read the data of a scene from a file or folder, or from a mesh of another library."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import path_of, text
from ..errors import InputError
from ..files import checked_file
from ..formats.library_meshes import KNOWN, data_of_mesh, is_mesh
from ..scene.mesh import Source
from ..scene.scene_bounds import guess_z_up, sampled_faces
from ..scene.scene_data import MemoryData, SceneData, check_up_axis
from ..store.store_format import STORE_SUFFIX

GLTF_SUFFIXES = (".glb", ".gltf")
MESH_SUFFIXES = (".obj", ".ply", ".stl")
CITY_SUFFIXES = (".json", ".jsonl")


def data_of(value: Any) -> SceneData:
    """The data of a scene, or of anything else that `antumbra.load` accepts."""
    data = getattr(value, "data", value)
    return data if isinstance(data, SceneData) else read_scene_data(value)


def read_scene_data(value: Any, up: str | None = None, lod: str | None = None) -> SceneData:
    """Read the data of a scene from a path or a mesh of another library."""
    if up is not None:
        check_up_axis(up)
    if lod is not None:
        text(lod, "lod")
    if is_mesh(value):
        return data_of_mesh(value, up=up or "y")
    if isinstance(value, (str, os.PathLike)):
        return _scene_in(path_of(value, "scene"), up, lod)
    kind = type(value).__name__
    raise InputError(f"scene is a {kind}; give the path of a file, a scene, or {KNOWN}; arrays go to Scene.from_arrays")


def _scene_in(path: Path, up: str | None, lod: str | None) -> SceneData:
    """Read a file or folder. Errors of libraries become an `InputError`."""
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


def _read(path: Path, up: str | None, lod: str | None) -> SceneData:
    # Readers are imported on demand: importing trimesh alone takes longer than loading most scenes.
    name, suffix = path.name or str(path), path.suffix.lower()
    if suffix in CITY_SUFFIXES and not path.is_dir():
        return _read_city(path, name, up, lod)
    if lod is not None:
        raise InputError(f"{name}: lod is for CityJSON files; leave it out")
    if path.is_dir():
        from ..formats.array_files import read_frames

        return _scene(*read_frames(path), path.resolve().name, up)
    if suffix == STORE_SUFFIX:
        from ..store.store_file import load_store

        return load_store(path)
    if suffix not in GLTF_SUFFIXES + MESH_SUFFIXES:
        known = ", ".join((*GLTF_SUFFIXES, *MESH_SUFFIXES, *CITY_SUFFIXES, STORE_SUFFIX))
        checked_file(path, name)
        description = f"format {suffix!r}" if suffix else "format, no suffix"
        raise InputError(f"{name}: unknown {description}; use one of {known}, or a folder")
    checked_file(path, name)
    if suffix in GLTF_SUFFIXES:
        from ..formats.gltf.gltf_source import read_gltf

        return _scene(*read_gltf(path), path.stem, up)
    from ..formats.mesh_files import read_mesh_file

    return _scene(*read_mesh_file(path), path.stem, up)


def _read_city(path: Path, name: str, up: str | None, lod: str | None) -> MemoryData:
    from ..formats.cityjson.cityjson_source import read_cityjson

    checked_file(path, name)
    city_file = read_cityjson(path, lod)
    name, city = path.stem.removesuffix(".city"), city_file.city
    return MemoryData(city_file.source, name=name, up=up or "z", notes=tuple(city_file.notes), city=city, crs=city.crs)


def _scene(source: Source, notes: list[str], name: str, up: str | None) -> MemoryData:
    scene = MemoryData(source, name=name, up=up or "y", notes=tuple(notes))
    if up is None and guess_z_up(sampled_faces(source, scene.n_triangles)):
        scene.up, scene.notes = "z", (*scene.notes, f'{source.file}: seems to have z up; pass up="y" to override')
    return scene
