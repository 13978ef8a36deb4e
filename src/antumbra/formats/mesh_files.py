"""PLY and STL files: triangles are read at once, unusual PLY files by trimesh; PLY output with face colours.

Rows that trimesh would misread are checked beforehand (`ply_rows`), the resulting arrays afterwards.
Importing trimesh takes longer than reading a million triangles.
"""

import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.extras import import_extra
from ..base.files import atomic_output
from ..base.wording import counted
from ..scene.materials import PLAIN, linear_to_srgb
from ..scene.mesh import (
    Mesh,
    StaticMeshes,
    VertexAttributes,
    check_faces,
    check_finite,
    distinct_vertices,
    flip_v,
    make_mesh,
    textured_mesh,
)
from ..scene.palette_scene import PaletteScene
from .face_ranges import FaceRanges, FileRows, RangedMesh, n_spans
from .obj_file import MeshNames
from .ply_rows import INDICES, PlyProperty, check_rows, elements_of
from .text_numbers import parsed_numbers

_PLY_ELEMENT = re.compile(rb"^element\s+(\S+)\s+(\d+)", re.MULTILINE)
_PLY_EMPTY = re.compile(rb"^element\s+(\S+)\s+0*[1-9]\d*\s*(?=^element\b|\Z)", re.MULTILINE)
_PLY_LINE = re.compile(rb"^(element|property)\s+(.+?)\s*$", re.MULTILINE)
_RGBA, _NORMAL = ("red", "green", "blue", "alpha"), ("nx", "ny", "nz")
_KNOWN = {*"xyz", *_NORMAL, *_RGBA}
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_SOLID = re.compile(rb"^[ \t]*(?:solid\b([^\n]*)\n|endsolid[^\n]*)", re.MULTILINE | re.IGNORECASE)
_STL_WORD, _STL_FACET = re.compile(rb"endfacet|facet|vertex"), [b"facet", b"vertex", b"vertex", b"vertex", b"endfacet"]
_TEXTURE = re.compile(rb"^comment\s+TextureFile\s+(.+?)\s*$", re.MULTILINE | re.IGNORECASE)
_MOST_PROPERTIES = 1000  # of a PLY file, and its elements
_STL_HEADER = 84  # bytes: a text, and the number of facets


# --- Reading ----------------------------------------------------------------------------------------------------------


def read_mesh_file(path: Path, streamed: bool = False) -> tuple[StaticMeshes | RangedMesh, list[str]]:
    """(source, notes) for a .ply or .stl file. The notes list everything left out.

    streamed : leave the faces in the file, if it is binary and of triangles only
    """
    file, where = path.name, f'{path.name}: mesh "{path.stem}"'
    if streamed and (ranges := _face_ranges(path, where)) is not None:
        return RangedMesh(ranges, path.stem, file, where), []
    data = path.read_bytes()
    if path.suffix.lower() == ".stl":
        is_text = _is_text(data)
        return StaticMeshes(_read_solids(data, path) if is_text else _read_facets(data, path.stem, where), file), []
    _check_ply(data, file)
    mesh = _read_triangles(data, path.stem, where)
    if mesh is not None:
        return StaticMeshes([mesh], file), []
    notes = check_rows(data, file)
    return StaticMeshes(_read_by_trimesh(data, path), file), notes + _ignored_textures(data, file)


def _read_facets(data: bytes, name: str, where: str) -> list[Mesh]:
    """The mesh of a binary STL file."""
    count = int.from_bytes(data[80:_STL_HEADER], "little")
    needed, file = _STL_HEADER + count * _FACET.itemsize, where.partition(":")[0]
    if len(data) != needed:
        raise InputError(f"{file}: STL header needs {needed} bytes, there are {len(data)}; copy the file again")
    return [_mesh_of_facets(np.frombuffer(data, _FACET, count, _STL_HEADER), name, where)]


def _mesh_of_facets(facets: np.ndarray, name: str, where: str) -> Mesh:
    return make_mesh(name, facets["corners"].reshape(-1, 3), None, None, where)


def _read_solids(data: bytes, path: Path) -> list[Mesh]:
    """The solids of an STL file of text."""
    solids = list(_solids_in(data, path.name))
    meshes, names = list[Mesh](), MeshNames("geometry", True)
    for label, body in solids:
        numbers = _corners_of(body, path.name)
        if len(numbers):
            name = path.stem if len(solids) == 1 else names.of(label.decode("utf-8", "replace").strip())
            meshes.append(make_mesh(name, numbers.reshape(-1, 3), None, None, f'{path.name}: mesh "{name}"'))
    return meshes


def _solids_in(data: bytes, file: str) -> Iterator[tuple[bytes, bytes]]:
    """(name, text up to the next "endsolid") of each solid.

    Raises
    ------
    InputError
        If there is text outside of solids, such as the last one of a file that is cut.
    """
    begin: re.Match[bytes] | None = None
    end = 0  # of the last solid
    for line in _SOLID.finditer(data):
        if line[1] is not None:
            begin = begin or line
        elif begin is not None:
            _check_blank(data[end : begin.start()], file)
            yield begin[1], data[begin.end() : line.start()]
            begin, end = None, line.end()
    _check_blank(data[end:], file)


def _check_blank(text: bytes, file: str) -> None:
    if text.strip():
        raise InputError(f"{file}: has a solid without endsolid; the file is cut short, copy it again")


def _corners_of(solid: bytes, file: str) -> np.ndarray:
    """(9 n,) float64: the corners of the facets of a solid."""
    text = solid.lower()
    numbers = parsed_numbers(_vertices_in(text), np.float64)
    if numbers is None:
        raise InputError(f"{file}: has a vertex of something other than numbers; export the mesh again")
    n_facets = text.count(b"endfacet")
    if len(numbers) != 9 * n_facets or _STL_WORD.findall(text) != _STL_FACET * n_facets:
        raise InputError(f"{file}: has a facet that is not three vertices of x y z; export the mesh again")
    return numbers


def _vertices_in(solid: bytes) -> bytes:
    """The rest of each line after "vertex"."""
    return b" ".join(rest.partition(b"\n")[0] for rest in solid.split(b"vertex")[1:])


def _read_triangles(data: bytes, name: str, where: str) -> Mesh | None:
    """The mesh of a PLY file with only vertices and triangles, without texture coordinates; None for others."""
    layout = _ply_layout(data, where.partition(":")[0])
    rows = None if layout is None else layout.text_rows(data) if layout.is_text else layout.rows(data)
    if rows is None or not (rows[1]["n"] == 3).all():
        return None
    vertices, faces = rows
    return _mesh_of_rows(vertices, faces, faces["corners"], name, where)


def _mesh_of_rows(vertices: np.ndarray, faces: np.ndarray, corners: np.ndarray, name: str, where: str) -> Mesh:
    """The mesh of rows of a PLY file; `corners`: (f, 3), which index the vertices."""
    of_faces, of_vertices = _colours(faces), _colours(vertices)
    mesh = make_mesh(name, _columns(vertices, *"xyz"), corners, of_faces, where)
    normals = _columns(vertices, *_NORMAL) if "nx" in (vertices.dtype.names or ()) else None
    material, attributes = PLAIN if of_faces is None else None, VertexAttributes(None, of_vertices, normals)
    return textured_mesh(mesh, corners, len(vertices), material, where, attributes)


def _colours(rows: np.ndarray) -> np.ndarray | None:
    """(n, 3 or 4) uint8: the colours of vertices or faces; None without any."""
    names = [channel for channel in _RGBA if channel in (rows.dtype.names or ())]
    return _columns(rows, *names) if names else None


def _columns(rows: np.ndarray, *names: str) -> np.ndarray:
    """(n, k): fields of structured rows, in native byte order."""
    return np.stack([rows[name].astype(rows.dtype[name].newbyteorder("=")) for name in names], 1)


class _PlyLayout(NamedTuple):
    """The layout of a PLY file whose faces are all triangles."""

    start: int  # the first byte after the header
    n_vertices: int
    vertex: np.dtype
    n_faces: int
    face: np.dtype  # fields: n, the number of corners; corners, three indices
    is_text: bool

    @property
    def faces_start(self) -> int:
        """The first byte of the faces of a binary file."""
        return self.start + self.n_vertices * self.vertex.itemsize

    @property
    def size(self) -> int:
        """The bytes of a binary file."""
        return self.faces_start + self.n_faces * self.face.itemsize

    def rows(self, data: bytes) -> tuple[np.ndarray, np.ndarray] | None:
        """The vertices and faces of a binary file; None if its size is another one."""
        if len(data) != self.size:
            return None
        vertices = np.frombuffer(data, self.vertex, self.n_vertices, self.start)
        return vertices, np.frombuffer(data, self.face, self.n_faces, self.faces_start)

    def text_rows(self, data: bytes) -> tuple[np.ndarray, np.ndarray] | None:
        """The same of a file of text, with int64 indices; None if it has other numbers."""
        numbers = parsed_numbers(data[self.start :], np.float64)
        names, channels = self.vertex.names or (), (self.face.names or ())[2:]
        n, width = self.n_vertices * len(names), 4 + len(channels)
        if numbers is None or len(numbers) != n + width * self.n_faces:
            return None
        vertices, table = np.empty(self.n_vertices, self.vertex), numbers[n:].reshape(-1, width)
        for name, column in zip(names, numbers[:n].reshape(-1, len(names)).T):
            vertices[name] = column
        faces = np.empty(self.n_faces, [("n", int), ("corners", int, 3), *((channel, "u1") for channel in channels)])
        faces["n"], faces["corners"] = table[:, 0], table[:, 1:4]
        for k, channel in enumerate(channels):
            faces[channel] = table[:, 4 + k]
        return (vertices, faces) if (faces["corners"] == table[:, 1:4]).all() else None


def _ply_layout(data: bytes, file: str) -> _PlyLayout | None:
    """The layout of a PLY file; None if it is unusual."""
    head, _, _ = data.partition(b"end_header")
    order = ">" if b"format binary_big_endian" in head else "<"
    elements = elements_of(head, file)
    if [name for name, _, _ in elements] != ["vertex", "face"]:
        return None
    (_, n_vertices, of_vertex), (_, n_faces, of_face) = elements
    vertex, face = _numpy_type(of_vertex, order), _face_type(of_face, order)
    names = () if vertex is None else vertex.names or ()
    if (
        vertex is None
        or face is None
        or not set(names).issuperset("xyz")
        or (_has_colour(vertex) and _has_colour(face))
    ):
        return None
    start = data.find(b"\n", len(head)) + 1
    return _PlyLayout(start, n_vertices, vertex, n_faces, face, b"format ascii" in head)


def _numpy_type(properties: list[PlyProperty], order: str) -> np.dtype | None:
    """The type of rows of numbers; None unless they are known, in the usual order of channels, which are bytes."""
    fields = [(each.name, order + each.kind) for each in properties if each.of_count is None]
    names = [name for name, _ in fields]
    if len(fields) != len(properties) or len(set(names)) != len(names) or not set(names) <= _KNOWN:
        return None
    channels = [(name, kind[1:]) for name, kind in fields if name in _RGBA]
    if channels not in ([], *([(name, "u1") for name in _RGBA[:n]] for n in (3, 4))):
        return None
    return np.dtype(fields) if set(names).isdisjoint(_NORMAL) or set(names).issuperset(_NORMAL) else None


def _face_type(properties: list[PlyProperty], order: str) -> np.dtype | None:
    """The type of triangles with optional colours; None for other faces."""
    if not properties or properties[0].of_count is None or properties[0].name not in INDICES:
        return None
    of_count, of_index = properties[0].of_count, properties[0].kind
    colours = _numpy_type(properties[1:], order)
    names = () if colours is None else colours.names or ()
    if "f" in of_count + of_index or colours is None or not set(names) <= set(_RGBA):
        return None
    return np.dtype([("n", order + of_count), ("corners", order + of_index, 3), *((name, "u1") for name in names)])


def _has_colour(rows: np.dtype) -> bool:
    return _RGBA[0] in (rows.names or ())


def _read_by_trimesh(data: bytes, path: Path) -> list[Mesh]:
    trimesh = import_extra("trimesh", f"{path.name}, which is not plain triangles,", "meshes")
    try:
        # from memory and without a resolver, so that nothing else is read; names of textures would be logged
        loaded = trimesh.load(io.BytesIO(data), file_type="ply", process=False, skip_materials=True)
    except IndexError as error:
        raise InputError(f"{path.name}: a face uses a missing vertex ({error}); export the mesh again") from error
    parts = loaded.geometry if isinstance(loaded, trimesh.Scene) else {path.stem: loaded}
    return [_mesh(name, part, path.name) for name, part in parts.items() if len(getattr(part, "faces", ()))]


def _mesh(name: str, part: Any, file: str) -> Mesh:
    where = f'{file}: mesh "{name}"'
    positions, faces = np.asarray(part.vertices), np.asarray(part.faces)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise InputError(f"{where} has vertices of {counted(positions.shape[-1], 'number')}; a vertex is x y z")
    colours = np.asarray(part.visual.face_colors) if part.visual.kind == "face" else None
    mesh = make_mesh(name, positions, faces, colours, where)  # checks the indices
    of_vertices = np.asarray(part.visual.vertex_colors) if part.visual.kind == "vertex" else None
    uv = flip_v(getattr(part.visual, "uv", None), len(positions))
    normals = part.vertex_normals if "vertex_normals" in part._cache else None  # only if from the file
    material = PLAIN if colours is None else None
    return textured_mesh(mesh, faces, len(positions), material, where, VertexAttributes(uv, of_vertices, normals))


def _is_text(stl: bytes) -> bool:
    if len(stl) == _STL_HEADER + int.from_bytes(stl[80:_STL_HEADER], "little") * _FACET.itemsize:
        return False  # the header of a binary file may begin with any word
    return stl.lstrip()[:5].lower() == b"solid" and b"facet" in stl.lower()


def _ignored_textures(data: bytes, file: str) -> list[str]:
    names = [name.decode("utf-8", "replace")[:60] for name in _TEXTURE.findall(data.partition(b"end_header")[0])]
    return [f"{file}: its texture {names[0]!r} is not shown"] if names else []


def _check_ply(data: bytes, file: str) -> None:
    """Raise InputError if the header declares more elements than fit in the file."""
    head, end, body = data.partition(b"end_header")
    if not data.startswith(b"ply") or not end:
        raise InputError(f"{file}: no PLY header; is this a PLY file?")
    for kind in (b"element", b"property"):
        if (count := len(re.findall(rb"^" + kind, head, re.MULTILINE))) > _MOST_PROPERTIES:
            raise InputError(
                f"{file}: PLY header has {counted(count, 'line')} of {kind.decode()}, more than {_MOST_PROPERTIES:,}; "
                "export x, y, z, colours and faces only"
            )
    if (empty := _PLY_EMPTY.search(head)) is not None:
        name = empty[1].decode("ascii", "replace")
        raise InputError(f"{file}: PLY header gives the element {name!r} no properties; export the file again")
    counts = {name: int(count) for name, count in _PLY_ELEMENT.findall(head)}
    available = len(body.split(b"\n")) if b"format ascii" in head else len(body)
    declared = sum(counts.values())
    if declared > available:
        raise InputError(
            f"{file}: PLY header declares {counted(declared, 'element')}, and has room for {available}; copy it again"
        )


# --- Files whose faces are read range by range ------------------------------------------------------------------------


_HEAD = 1 << 20  # bytes in which the header of a PLY file ends
_MOST_ROWS = 1 << 31  # indices are int32


def spans_of_mesh_file(path: Path) -> int:
    """The number of spans of a .ply or .stl file of which any faces can be read; 1 for others."""
    ranges = _face_ranges(path, path.name)
    return 1 if ranges is None else n_spans(ranges)


def _face_ranges(path: Path, where: str) -> FaceRanges | None:
    """The faces of a binary file of triangles, which are read as they are needed; None for other files."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
    if path.suffix.lower() == ".stl":
        count = int.from_bytes(head[80:_STL_HEADER], "little")
        return _StlFaces(path, count, where) if size == _STL_HEADER + count * _FACET.itemsize else None
    layout = _ply_layout(head, path.name) if head.startswith(b"ply") and b"end_header" in head else None
    if layout is None or layout.is_text or layout.size != size or layout.n_vertices >= _MOST_ROWS:
        return None
    return _PlyFaces(path, layout, where)


class _StlFaces:
    """The facets of a binary STL file."""

    def __init__(self, path: Path, n_faces: int, where: str):
        self.n_faces, self._name, self._where = n_faces, path.stem, where
        self._facets = FileRows(path, _FACET, _STL_HEADER)

    def mesh(self, faces: NDArray[np.int64]) -> Mesh:
        facets = self._facets[faces]
        numbers = 3 * faces[:, None] + np.arange(3)
        check_finite(facets["corners"].reshape(-1, 3), self._where, numbers.reshape(-1))
        return _mesh_of_facets(facets, self._name, self._where)


class _PlyFaces:
    """The faces of a binary PLY file of triangles."""

    def __init__(self, path: Path, layout: _PlyLayout, where: str):
        self.n_faces, self._n_vertices = layout.n_faces, layout.n_vertices
        self._name, self._file, self._where = path.stem, path.name, where
        self._vertices = FileRows(path, layout.vertex, layout.start)
        self._faces = FileRows(path, layout.face, layout.faces_start)

    def mesh(self, faces: NDArray[np.int64]) -> Mesh:
        rows = self._faces[faces]
        if (others := np.flatnonzero(rows["n"] != 3)).size:
            face, n = int(faces[others[0]]), int(rows["n"][others[0]])
            raise InputError(
                f"{self._file}: face {face} has {counted(n, 'corner')}; triangulate the mesh, and export it again"
            )
        used, corners = distinct_vertices(check_faces(rows["corners"], self._n_vertices, self._where, int(faces[0])))
        vertices = self._vertices[used]
        check_finite(_columns(vertices, *"xyz"), self._where, used)
        return _mesh_of_rows(vertices, rows, corners, self._name, self._where)._replace(numbers=used)


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
