"""Read the data of a scene from a file or folder, or from a mesh of another library."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from ..base.checks import flag, text
from ..base.errors import InputError
from ..base.files import checked_file
from ..formats.example_files import scene_path
from ..formats.foreign_formats import cure_of
from ..formats.format_registry import FORMATS, FRAMES, GLB, GLTF, format_of, format_taking
from ..formats.library_meshes import KNOWN, data_of_mesh, is_mesh
from ..formats.scene_format import Contents, Format, ReadOptions
from ..scene.scene_data import SceneData, check_up_axis
from ..store.store_format import STORE_SUFFIX, TILES_SUFFIX

_DEFAULT = ReadOptions()


def _open_store(path: Path, options: ReadOptions) -> SceneData:
    from ..store.store_data import load_store
    from ..store.tiled_store import load_tiles

    return load_tiles(path) if path.suffix.lower() == TILES_SUFFIX else load_store(path)


STORE = Format("store", (STORE_SUFFIX, TILES_SUFFIX), _open_store, None, None, "animation and semantic surfaces")

SCENE_FORMATS = *FORMATS, STORE
"""All formats that `antumbra.load` reads."""

SCENE_SUFFIXES = tuple(suffix for each in SCENE_FORMATS for suffix in each.suffixes)


def data_of(value: Any) -> SceneData:
    """The data of a scene, or of anything else that `antumbra.load` accepts."""
    data = getattr(value, "data", value)
    return data if isinstance(data, SceneData) else read_scene_data(value)


def read_scene_data(value: Any, options: ReadOptions = _DEFAULT) -> SceneData:
    """Read the data of a scene from a path or a mesh of another library."""
    if options.up is not None:
        check_up_axis(options.up)
    if options.lod is not None:
        text(options.lod, "lod")
    if options.instances is not None:
        flag(options.instances, "instances")
    if is_mesh(value):
        return data_of_mesh(value, up=options.up)
    if (taking := format_taking(value)) is not None:
        return taking.read(value, options)
    if isinstance(value, (str, os.PathLike)):
        return _scene_in(scene_path(value), options)
    kind = type(value).__name__
    raise InputError(
        f"scene is of type {kind}; give the path of a file, a scene, a DataArray, or {KNOWN}; arrays go to "
        "Scene.from_arrays"
    )


def _scene_in(path: Path, options: ReadOptions) -> SceneData:
    """Read a file or folder. Errors of libraries become an `InputError`."""
    try:
        with np.errstate(all="ignore"):
            return _read(path, options)
    except InputError:
        raise
    except MemoryError as error:
        raise InputError(f"{path.name}: not enough memory for this scene; use a smaller one") from error
    except Exception as error:  # a library failed on input that passed all checks
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path.name}: cannot be read ({reason}); is the file damaged?") from error


def _read(path: Path, options: ReadOptions) -> SceneData:
    name, file_format = path.name or str(path), format_of(path, SCENE_FORMATS)
    if options.lod is not None and (file_format is None or file_format.contents is not Contents.CITY):
        raise InputError(f"{name}: lod is for CityJSON files; leave it out")
    if file_format not in (FRAMES, STORE) and (file_format is None or not file_format.by_url):
        checked_file(path, name)
    if (cure := cure_of(path)) and not path.is_dir():
        raise InputError(f"{name}: {cure}")
    if file_format is None:
        description = f"format {path.suffix.lower()!r}" if path.suffix else "format, no suffix"
        raise InputError(f"{name}: unknown {description}; use one of {', '.join(SCENE_SUFFIXES)}, or a folder")
    if options.instances and file_format not in (GLB, GLTF):
        raise InputError(f"{name}: has no instances, unlike glTF files; leave instances out")
    return file_format.read(path, options)
