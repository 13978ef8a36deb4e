"""OBJ, PLY and STL files: trimesh parses them, and this module checks their numbers."""

import io
import logging
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import InputError
from .colour import BYTE_TO_LINEAR, mean_linear
from .files import checked_file, sibling
from .mesh import Mesh, make_mesh
from .source import StaticMeshes

logging.getLogger("trimesh").addHandler(logging.NullHandler())  # keeps its tracebacks off the screen

MAX_SIDE_FILE = 1 << 28
_PLY_ELEMENT = re.compile(rb"^element\s+(\S+)\s+(\d+)", re.MULTILINE)
_OBJ_ZERO = re.compile(rb"^\s*f\s(?:[^\n]*\s)?0+(?=[/\s]|$)", re.MULTILINE)


def read_mesh_file(path: Path) -> tuple[StaticMeshes, list[str]]:
    """(source, notes) of an .obj, .ply or .stl file. The notes list everything that was left out."""
    import trimesh

    data, file, kind = path.read_bytes(), path.name, path.suffix.lower()[1:]
    if kind == "ply":
        _check_ply(data, file)
    elif kind == "obj":
        _check_obj(data, file)
    else:
        _check_stl(data, file)
    textures = FolderResolver(path.parent, file)
    try:
        loaded = trimesh.load(io.BytesIO(data), file_type=kind, resolver=textures, process=False)
    except IndexError as error:
        raise InputError(f"{file}: a face uses a missing vertex ({error}); export the mesh again") from error
    parts = loaded.geometry if isinstance(loaded, trimesh.Scene) else {path.stem: loaded}
    meshes = [_mesh(name, part, textures) for name, part in parts.items() if len(getattr(part, "faces", ()))]
    return StaticMeshes(meshes, file), textures.notes


class FolderResolver(Mapping):
    """Gives trimesh the material and texture files in the scene's folder, and no others."""

    def __init__(self, folder: Path, file: str):
        self.notes: list[str] = []
        self._folder, self._file = folder, file
        self._means: dict[str, np.ndarray] = {}

    def get(self, name: str, default=None) -> bytes:
        """The contents of the file `name`. An unreadable file is noted and raises OSError."""
        where = f"{self._file}: file {name[:80]!r}"
        try:
            name = name.strip().replace("\\", "/")
            path = checked_file(sibling(self._folder, name, f"{self._file}: file"), where)
            if path.stat().st_size > MAX_SIDE_FILE:
                raise InputError(f"{where} is too large")
            return path.read_bytes()
        except (InputError, OSError) as error:
            self.notes.append(f"{error} (its colours are taken as white)")
            raise OSError(str(error)) from error

    def __getitem__(self, name: str) -> bytes:
        return self.get(name)

    def __iter__(self):
        return iter(())  # files are not listed

    def __len__(self) -> int:
        return 0

    def mean(self, name: str) -> np.ndarray:
        """The mean linear colour ((3,) float64) of a texture; white if it cannot be read."""
        if name not in self._means:
            try:
                self._means[name] = mean_linear(self.get(name))
            except OSError:
                self._means[name] = np.ones(3)
            except ValueError as error:
                self.notes.append(f"{self._file}: texture {name[:80]!r} is unusable ({error}); taken as white")
                self._means[name] = np.ones(3)
        return self._means[name]


def _mesh(name: str, part, textures: FolderResolver) -> Mesh:
    where = f'{textures._file}: mesh "{name}"'
    positions, faces = np.asarray(part.vertices), np.asarray(part.faces)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise InputError(f"{where} has vertices of {positions.shape[-1]} numbers; a vertex is x y z")
    mesh = make_mesh(name, positions, faces, None, where)  # checks the indices
    return mesh._replace(colour=_colour(part.visual, faces, textures).astype(np.float32))


def _colour(visual, faces: np.ndarray, textures: FolderResolver) -> np.ndarray:
    """The linear base colour, (3,) or (f, 3). Vertices and faces have sRGB bytes, materials (Kd) linear bytes."""
    if visual.kind == "vertex":
        return BYTE_TO_LINEAR[np.asarray(visual.vertex_colors)[:, :3]][faces].mean(axis=1)
    if visual.kind == "face":
        return BYTE_TO_LINEAR[np.asarray(visual.face_colors)[:, :3]]
    material = getattr(visual, "material", None)
    diffuse = getattr(material, "diffuse", None)
    colour = np.ones(3) if diffuse is None else np.asarray(diffuse)[:3] / 255.0
    image = getattr(material, "image", None)
    texture = None if image is None else image.info.get("file_path")
    return colour if texture is None else colour * textures.mean(texture)


def _check_ply(data: bytes, file: str) -> None:
    """Raise InputError if the header declares more elements than fit in the file."""
    head, end, body = data.partition(b"end_header")
    if not data.startswith(b"ply") or not end:
        raise InputError(f"{file}: no PLY header; is this a PLY file?")
    counts = {name: int(count) for name, count in _PLY_ELEMENT.findall(head)}
    room = len(body.split(b"\n")) if b"format ascii" in head else len(body)
    declared = sum(counts.values())
    if declared > room:
        raise InputError(f"{file}: PLY header declares {declared} elements, there is room for {room}; copy it again")


def _check_stl(data: bytes, file: str) -> None:
    """Raise InputError if a binary STL is shorter than its header says. trimesh takes it for empty text."""
    if data.lstrip().startswith(b"solid") and b"facet" in data:
        return
    needed = 84 + 50 * int.from_bytes(data[80:84], "little")
    if len(data) < needed:
        raise InputError(f"{file}: STL header needs {needed} bytes, there are {len(data)}; copy the file again")


def _check_obj(data: bytes, file: str) -> None:
    """Raise InputError on vertex number 0, which is invalid in OBJ. trimesh takes it for 1."""
    match = _OBJ_ZERO.search(data)
    if match:
        line = data.count(b"\n", 0, match.end()) + 1
        raise InputError(f"{file}: line {line} uses vertex 0; OBJ counts vertices from 1, export the mesh again")
