"""OBJ, PLY and STL files: parsed by trimesh, with checks before and after; OBJ and PLY output with face colours.

Headers, sizes and vertex indices that trimesh would misread are checked beforehand, the resulting arrays afterwards.
"""

import io
import logging
import re
from collections.abc import Iterator, Mapping
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..files import atomic_output, checked_file, sibling
from ..scene.materials import BLEND, MASK, OPAQUE, PLAIN, Material, Texture, decode_image, linear_to_srgb
from ..scene.mesh import Mesh, StaticMeshes, VertexAttributes, flip_v, make_mesh, textured_mesh
from ..scene.palette_scene import PaletteScene

logging.getLogger("trimesh").addHandler(logging.NullHandler())  # keeps its tracebacks off the screen

MAX_SIDE_FILE = 1 << 28
_PLY_ELEMENT = re.compile(rb"^element\s+(\S+)\s+(\d+)", re.MULTILINE)
_OPTIONS = re.compile(r"^(?:-(?:[ost]\s+\S+\s+\S+\s+\S+|mm\s+\S+\s+\S+|\w+\s+\S+)\s+)+")  # before a texture's name
_OBJ_HEAD = re.compile(rb"^(usemtl|o|f|g|s) ([^\n]*)", re.MULTILINE)
_OBJ_OBJECT = re.compile(rb"^o [^\n]*", re.MULTILINE)
_OBJ_ZERO = re.compile(rb"^\s*f\s(?:[^\n]*\s)?0+(?=[/\s]|$)", re.MULTILINE)


# --- Reading ----------------------------------------------------------------------------------------------------------


def read_mesh_file(path: Path) -> tuple[StaticMeshes, list[str]]:
    """(source, notes) for an .obj, .ply or .stl file. The notes list everything left out."""
    import trimesh

    data, file, kind = path.read_bytes(), path.name, path.suffix.lower()[1:]
    if kind == "ply":
        _check_ply(data, file)
    elif kind == "obj":
        _check_obj(data, file)
    else:
        _check_stl(data, file)
    textures = FolderResolver(path.parent, file, _obj_name(data) if kind == "obj" else "geometry")
    data = _OBJ_OBJECT.sub(b"", data) if kind == "obj" else data
    try:
        loaded = trimesh.load(io.BytesIO(data), file_type=kind, resolver=textures, process=False)
    except IndexError as error:
        raise InputError(f"{file}: a face uses a missing vertex ({error}); export the mesh again") from error
    parts = loaded.geometry if isinstance(loaded, trimesh.Scene) else {path.stem: loaded}
    meshes = [_mesh(name, part, textures) for name, part in parts.items() if len(getattr(part, "faces", ()))]
    return StaticMeshes(meshes, file), textures.notes


class FolderResolver(Mapping[str, bytes]):
    """A trimesh resolver for material and texture files in the scene's folder only; also supplies mesh names."""

    def __init__(self, folder: Path, file: str, name: str = "geometry"):
        self.notes: list[str] = []
        self._folder, self.file = folder, file
        self._names = _names(name)
        self._textures: dict[tuple[str, str], Texture | None] = {}

    def get(self, name: str, default: Any = None) -> bytes:
        """The contents of the file `name`. An unreadable file adds a note and raises OSError."""
        name = _OPTIONS.sub("", name.strip()).replace("\\", "/")
        where = f"{self.file}: file {name[:80]!r}"
        try:
            path = checked_file(sibling(self._folder, name, f"{self.file}: file"), where)
            if path.stat().st_size > MAX_SIDE_FILE:
                raise InputError(f"{where} is too large")
            return path.read_bytes()
        except (InputError, OSError) as error:
            self.notes.append(f"{error} (its colours are taken as white)")
            raise OSError(str(error)) from error

    @property
    def file_name(self) -> str:
        """The name of the next mesh of an OBJ file whose materials are missing.

        trimesh gives all of them this name and then searches for a free number from 1 on: a million tries for 1,400.
        """
        return next(self._names)

    def __getitem__(self, name: str) -> bytes:
        return self.get(name)

    def __iter__(self) -> Iterator[str]:
        return iter(())  # files are not listed

    def __len__(self) -> int:
        return 0

    def texture(self, colour: str, opacity: str) -> Texture | None:
        """A texture from the file `colour`, with the brightness of the file `opacity` as alpha; "": no file.

        None if neither file can be read.
        """
        if (colour, opacity) not in self._textures:
            data = [self._decodable(name) for name in (colour, opacity)]
            texture = Texture(f"{self.file}: {colour or opacity}", data[0], has_alpha=bool(data[1]), opacity=data[1])
            self._textures[colour, opacity] = texture if data[0] or data[1] else None
        return self._textures[colour, opacity]

    def _decodable(self, name: str) -> bytes | None:
        if not name:
            return None
        try:
            data = self.get(name)
            decode_image(data, 1)
        except ValueError as error:
            if not isinstance(error, InputError):
                self.notes.append(f"{self.file}: texture {name[:80]!r} is unusable ({error}); taken as white")
            return None
        except OSError:  # `get` has added a note
            return None
        return data


def _mesh(name: str, part: Any, textures: FolderResolver) -> Mesh:
    where = f'{textures.file}: mesh "{name}"'
    positions, faces = np.asarray(part.vertices), np.asarray(part.faces)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise InputError(f"{where} has vertices of {positions.shape[-1]} numbers; a vertex is x y z")
    colours = np.asarray(part.visual.face_colors) if part.visual.kind == "face" else None
    mesh = make_mesh(name, positions, faces, colours, where)  # checks the indices
    if colours is not None:
        return mesh
    of_vertices = np.asarray(part.visual.vertex_colors) if part.visual.kind == "vertex" else None
    uv = flip_v(getattr(part.visual, "uv", None), len(positions))
    normals = part.vertex_normals if "vertex_normals" in part._cache else None  # only if from the file
    material = _material(getattr(part.visual, "material", None), textures)
    return textured_mesh(mesh, faces, len(positions), material, where, VertexAttributes(uv, of_vertices, normals))


def _material(mtl: Any, textures: FolderResolver) -> Material:
    """A material from an MTL file: Kd (linear) and d or Tr, with the textures map_Kd and map_d."""
    if mtl is None:
        return PLAIN
    diffuse, options = getattr(mtl, "diffuse", None), getattr(mtl, "kwargs", {})
    r, g, b = (np.ones(3) if diffuse is None else np.asarray(diffuse)[:3] / 255.0).tolist()
    image = getattr(mtl, "image", None)
    colour_file = "" if image is None else image.info.get("file_path", "")
    opacity_file = " ".join(options.get("map_d", ()))
    alpha = _number(options.get("d"), 1.0) if "d" in options else 1.0 - _number(options.get("tr"), 0.0)
    texture = textures.texture(colour_file, opacity_file) if colour_file or opacity_file else None
    mode = MASK if texture is not None and texture.has_alpha else BLEND if alpha < 1.0 else OPAQUE
    return Material(getattr(mtl, "name", None) or "", (r, g, b, alpha), texture, mode)


def _number(words: Any, default: float) -> float:
    """The last number on a line of an MTL file, clamped to [0, 1]."""
    try:
        return float(np.clip(float(words[-1]), 0.0, 1.0))
    except (TypeError, ValueError, IndexError):
        return default


def _check_ply(data: bytes, file: str) -> None:
    """Raise InputError if the header declares more elements than fit in the file."""
    head, end, body = data.partition(b"end_header")
    if not data.startswith(b"ply") or not end:
        raise InputError(f"{file}: no PLY header; is this a PLY file?")
    counts = {name: int(count) for name, count in _PLY_ELEMENT.findall(head)}
    available = len(body.split(b"\n")) if b"format ascii" in head else len(body)
    declared = sum(counts.values())
    if declared > available:
        raise InputError(
            f"{file}: PLY header declares {declared} elements, but there is room for {available}; copy it again"
        )


def _check_stl(data: bytes, file: str) -> None:
    """Raise InputError if a binary STL is shorter than its header declares. trimesh would read it as empty ASCII."""
    if data.lstrip().startswith(b"solid") and b"facet" in data:
        return
    needed = 84 + 50 * int.from_bytes(data[80:84], "little")
    if len(data) < needed:
        raise InputError(f"{file}: STL header needs {needed} bytes, there are {len(data)}; copy the file again")


def _obj_name(data: bytes) -> str:
    """The name that trimesh gives to meshes of an OBJ file without materials: the ``o`` line before all faces."""
    first = _OBJ_HEAD.search(data)
    return "geometry" if first is None or first[1] != b"o" else first[2].strip().decode("utf-8", "replace")


def _names(name: str) -> Iterator[str]:
    """Distinct names as trimesh generates them: name, name_1, name_2 ...; or part_7, part_8 ..."""
    if name:
        yield name
    stem, mark, number = name.rpartition("_")
    numbered = bool(mark) and number.isdecimal()
    stem, last = (stem, int(number)) if numbered else (name or "geometry", 0)
    yield from (f"{stem}_{i}" for i in count(last + 1))


def _check_obj(data: bytes, file: str) -> None:
    """Raise InputError on vertex index 0, which is invalid in OBJ. trimesh would read it as 1."""
    match = _OBJ_ZERO.search(data)
    if match:
        line = data.count(b"\n", 0, match.end()) + 1
        raise InputError(f"{file}: line {line} uses vertex 0; OBJ counts vertices from 1, export the mesh again")


# --- Writing ----------------------------------------------------------------------------------------------------------


def write_ply(scene: PaletteScene, path: Path) -> list[Path]:
    """Write a scene to a binary PLY file with 8-bit sRGB face colours; return its path in a list."""
    rgb = np.round(255.0 * linear_to_srgb(np.asarray(scene.palette, float))).astype(np.uint8)
    vertices = np.ascontiguousarray(scene.vertices, "<f4")
    faces = np.empty(len(scene.faces), [("n", "u1"), ("corners", "<i4", 3), ("rgb", "u1", 3)])
    faces["n"], faces["corners"], faces["rgb"] = 3, scene.faces, rgb[scene.colour]
    head = [
        "ply\nformat binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(faces)}\nproperty list uchar int vertex_indices",
        *(f"property uchar {channel}" for channel in ("red", "green", "blue")),
        "end_header\n",
    ]
    with atomic_output(path) as temporary:
        temporary.write_bytes("\n".join(head).encode() + vertices.tobytes() + faces.tobytes())
    return [path]


def write_obj(scene: PaletteScene, name: str, path: Path) -> list[Path]:
    """Write a scene to an .obj file, and its colours to an .mtl file next to it; return both paths."""
    library = path.with_suffix(".mtl")
    lines = [f"mtllib {library.name}", f"o {name}"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in np.asarray(scene.vertices).tolist()]
    colour = np.asarray(scene.colour)
    order = np.argsort(colour, kind="stable")
    groups = np.split(np.asarray(scene.faces)[order] + 1, np.flatnonzero(np.diff(colour[order])) + 1)
    names = np.unique(colour).tolist()
    for k, faces in zip(names, groups):
        lines.append(f"usemtl colour{k}")
        lines += [f"f {a} {b} {c}" for a, b, c in faces.tolist()]
    paints = ["newmtl colour{}\nKd {:.6g} {:.6g} {:.6g}\n".format(k, *np.asarray(scene.palette)[k]) for k in names]
    with atomic_output(library) as paint_file, atomic_output(path) as file:
        paint_file.write_text("\n".join(paints), encoding="utf-8")
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return [path, library]
