"""The registry of scene file formats: how each is read and written, and what is lost.

Scene loading, exports, their error messages, the help of commands and ``antumbra formats`` derive from it. Readers and
writers are imported when called: importing trimesh alone takes longer than loading most scenes.
"""

import os
from collections.abc import Iterable
from functools import partial
from os import PathLike
from pathlib import Path
from typing import cast

import numpy as np

from ..base import wings
from ..base.files import checked_output
from ..base.memory import check_reading
from ..scene.instance_data import InstanceData, wants_instances, would_be_instances
from ..scene.instances import InstancedSource
from ..scene.mesh import Source
from ..scene.palette_scene import PaletteScene
from ..scene.rounded_coordinates import rounding_notes
from ..scene.scene_bounds import guess_z_up
from ..scene.scene_data import MemoryData, SceneData
from ..scene.streamed_data import StreamedData
from .face_ranges import BINARY_PLY
from .scene_format import Contents, Format, ReadOptions

_TALLEST = 2000.0  # metres: higher than any building

# --- Readers and writers ----------------------------------------------------------------------------------------------


_TRIANGLE_BYTES = 60  # of a scene in memory, without trees
_SOURCE_BYTES = 30  # of its meshes alone


def _data_of(source: Source, notes: list[str], name: str, options: ReadOptions) -> SceneData:
    """A scene whose up axis, unless given, is guessed from its faces."""
    scene: MemoryData | InstanceData | StreamedData
    up = options.up or "y"
    if not options.streamed and wants_instances(source, options.instances, options.cutouts):
        scene = InstanceData(cast(InstancedSource, source), name=name, up=up, notes=tuple(notes))
    else:
        if options.streamed:
            if getattr(source, "in_memory", True):
                triangles = sum(mesh.triangles for mesh in source.meshes)
                check_reading(_SOURCE_BYTES * triangles, source.file, cure=BINARY_PLY)
            scene = StreamedData(source, name=name, up=up, notes=tuple(notes))
            scene.has_copies = would_be_instances(scene, options.instances, options.cutouts)
        else:
            triangles = sum(mesh.triangles * mesh.instances for mesh in source.meshes)
            check_reading(_TRIANGLE_BYTES * triangles, source.file)
            scene = MemoryData(source, name=name, up=up, notes=tuple(notes))
    sample = partial(scene.sampled_faces, 0.0)
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

    return _data_of(*read_gltf(path, options.animation, options.streamed), path.stem, options)


def _write_glb(scene: PaletteScene, name: str, path: Path) -> list[Path]:
    from .gltf.gltf_writer import write_glb

    return write_glb(scene, name, path)


def _read_mesh_file(path: Path, options: ReadOptions) -> SceneData:
    from .mesh_files import read_mesh_file

    return _with_unit(_data_of(*read_mesh_file(path, options.streamed), path.stem, options), path.name, options)


def _read_obj(path: Path, options: ReadOptions) -> SceneData:
    from .obj_file import read_obj
    from .obj_stream import stream_obj

    if options.streamed and (streamed := stream_obj(path)) is not None:
        return _with_unit(_data_of(*streamed, path.stem, options), path.name, options)
    return _with_unit(_data_of(*read_obj(path), path.stem, options), path.name, options)


def _write_obj(scene: PaletteScene, name: str, path: Path) -> list[Path]:
    from .obj_file import write_obj

    return write_obj(scene, name, path)


def _write_ply(scene: PaletteScene, name: str, path: Path) -> list[Path]:
    from .mesh_files import write_ply

    return write_ply(scene, path)


def _read_frames(path: Path, options: ReadOptions) -> SceneData:
    from .array_files import read_frames

    return _data_of(*read_frames(path), path.resolve().name, options)


# --- The registry -----------------------------------------------------------------------------------------------------


_GLTF_LOST = "refraction, clearcoat and sheen of materials, cones of spot lights, points and lines"
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
    "all of materials but Kd, Ke, d, Tr, Pm, Pr, their maps of colour, and norm; lines and curves; when written: "
    "cameras and lights",
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
FRAMES = Format("folder of vertex frames", (), _read_frames, None, None, "alpha of face colours")

FORMATS: tuple[Format, ...] = (
    GLB,
    GLTF,
    OBJ,
    PLY,
    STL,
    *(each for place in wings.FORMATS for each in wings.named(place)),
    FRAMES,
)
"""Formats of scenes in memory, in display order."""

SCENE_WRITERS = {suffix: each.write for each in FORMATS if each.write is not None for suffix in each.suffixes}
"""Suffix -> writer."""


def format_of(path: Path, formats: Iterable[Format] = FORMATS) -> Format | None:
    """The format of a path among `formats`, by its suffix in any case; for a folder, `FRAMES`; None if unknown."""
    if os.path.isdir(path):  # False for names that the system refuses
        return FRAMES
    suffix = path.suffix.lower()
    return next((each for each in formats if suffix in each.suffixes), None)


def format_taking(value: object, formats: Iterable[Format] = FORMATS) -> Format | None:
    """The format whose reader takes an object of another library; None if there is none."""
    return next((each for each in formats if each.takes is not None and each.takes(value)), None)


def suffixes_of(contents: Contents) -> tuple[str, ...]:
    """The suffixes of formats with such contents."""
    return tuple(suffix for each in FORMATS if each.contents == contents for suffix in each.suffixes)


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
