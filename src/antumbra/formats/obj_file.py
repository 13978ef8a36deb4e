"""OBJ files: all lines of one kind are parsed at once, in NumPy.

The lines of vertices, texture coordinates and normals become arrays of correctly rounded float64, and those of faces an
array of corners. Faces of one material form a mesh; corners that agree in all three indices share a vertex. Materials
come from MTL files beside it.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.files import atomic_output, checked_file, sibling
from ..base.wording import counted
from ..kernels.parallel import map_in_threads
from ..scene.materials import (
    BLEND,
    MASK,
    OPAQUE,
    PLAIN,
    Material,
    PbrParameters,
    Texture,
    TextureMap,
    check_textures,
    checked_size,
    without_texture,
)
from ..scene.mesh import Mesh, StaticMeshes, VertexAttributes, flip_v, make_mesh, textured_mesh
from ..scene.palette_scene import PaletteScene
from .text_numbers import parsed_numbers

_SPACE, _NEWLINE, _SLASH = b" \n/"
_PREFIXES = {"v": b"v  ", "vt": b"vt ", "vn": b"vn ", "f": b"f  "}
_IRREGULAR = b"\t", b"\v", b"\f", b"\r", b"\n "  # white space that `_lines_of` replaces
_CURE = "export the mesh again"
_NUMBERS = {"v": 3, "vt": 2, "vn": 3}  # that lines of a kind have, unless all have fewer
_OTHERS = list(b"\n#!$lpsguom")  # first bytes of comments, lines, points, groups and names
_WORDS = {
    *b"vp cstype deg bmat step curv curv2 surf parm trim hole scrv sp end con bevel c_interp d_interp lod".split(),
    *b"shadow_obj trace_obj ctech stech csh call bzp bsp cdc cdp res".split(),
}  # that begin other lines


def read_obj(path: Path) -> tuple[StaticMeshes, list[str]]:
    """(source, notes) for an .obj file. The notes list everything left out."""
    part, files = ObjPart.of_text(path.read_bytes(), path.name), SideFiles(path.parent, path.name)
    materials = read_materials(part.heads.libraries, files)
    attributes = ObjAttributes.of_numbers(part.numbers, len(part.corners) > 0, path.name)
    meshes, names = list[Mesh](), MeshNames(part.heads.name, len(materials) > 1)
    groups = list(part.groups())
    for material, corners in groups:
        name = names.of(material) if len(groups) > 1 else path.stem
        meshes.append(attributes.mesh(name, corners, materials.get(material)))
    return StaticMeshes(meshes, path.name), files.notes + notes_on([part.summary], part.numbers, path.name)


class PartSummary(NamedTuple):
    """What notes on consecutive lines of a file need."""

    n_thin: int  # faces with fewer than three corners
    unknown: list[tuple[int, str]]  # lines that begin with none of the words of OBJ files: (number, word)
    most: NDArray[np.int64]  # (3,): the largest number of a vertex, texture coordinate and normal of a corner; -1: none


class ObjPart(NamedTuple):
    """What consecutive lines of a file say."""

    n_lines: int
    numbers: "list[NumberRows]"  # vertices, texture coordinates and normals
    corners: NDArray[np.int64]  # as `_PolygonTriangles.corners`, with the numbers of the whole file
    face_rows: NDArray[np.int64]  # (n,) int64: the line of each triangle
    heads: "_Heads"
    summary: PartSummary

    @classmethod
    def of_text(cls, text: bytes, file: str, first: int = 0, earlier: tuple[int, ...] = (0, 0, 0)) -> "ObjPart":
        """Whole lines of a file.

        first : the number of lines before them
        earlier : the numbers of vertices, texture coordinates and normals before them
        """
        lines = _lines_of(text)._replace(first=first)
        rows = {kind: lines.rows(prefix) for kind, prefix in _PREFIXES.items()}
        numbers: list[NumberRows] = [_numbers(lines, rows[kind], kind, file) for kind in _NUMBERS]
        triangles = _triangles(lines, rows, file, earlier)
        n_thin = len(rows["f"]) - len(np.unique(triangles.line))
        most = np.asarray(triangles.corners.max(axis=(0, 1), initial=-1))
        summary = PartSummary(n_thin, _unknown_lines(lines, rows), most)
        heads, of_faces = _Heads.of_lines(lines, file), rows["f"][triangles.line]
        return cls(len(lines.starts), numbers, triangles.corners, of_faces, heads, summary)

    def groups(self, material: str | None = None) -> Iterator[tuple[str | None, NDArray[np.int64]]]:
        """The corners of the triangles by material, the last material first; `material`: before the first head."""
        return ((name, self.corners[chosen]) for name, chosen in self.heads.groups(self.face_rows, material))


def _unknown_lines(lines: "_FileLines", rows: dict[str, NDArray[np.int64]]) -> list[tuple[int, str]]:
    known = np.zeros(len(lines.starts), bool)
    known[np.concatenate(list(rows.values()))] = True
    known |= np.isin(lines.data[lines.starts], _OTHERS)
    words = [(lines.first + row + 1, lines.line(row).split(b" ")[0]) for row in np.flatnonzero(~known).tolist()]
    return [(row, word.decode("utf-8", "replace")) for row, word in words if word not in _WORDS]


def notes_on(parts: Sequence[PartSummary], numbers: "Sequence[NumberRows]", file: str) -> list[str]:
    """Notes on what is left out of a file, whose vertices, texture coordinates and normals are `numbers`."""
    notes, unknown = list[str](), [line for part in parts for line in part.unknown]
    if n_thin := sum(part.n_thin for part in parts):
        notes.append(f"{file}: left out {counted(n_thin, 'face')} with fewer than 3 corners")
    if unknown:
        row, word = unknown[0]
        what = f"line {row} begins with {word[:20]!r}"
        notes.append(f"{file}: left out {counted(len(unknown), 'line')} of unknown words; {what}")
    for column, attribute in ((1, "texture coordinates"), (2, "normals")):
        if max((int(part.most[column]) for part in parts), default=-1) >= len(numbers[column]):
            notes.append(f"{file}: faces use {attribute} that the file lacks; these are left out")
    return notes


# --- Lines and numbers ------------------------------------------------------------------------------------------------


class _FileLines(NamedTuple):
    """The lines of a file."""

    data: NDArray[np.uint8]  # bytes, with three more after the last newline
    starts: NDArray[np.int64]  # (n,) int64: the first byte of each line
    ends: NDArray[np.int64]  # (n,) int64: the position of its newline
    first: int = 0  # the number of lines of the file before them, for errors

    def rows(self, prefix: bytes) -> NDArray[np.int64]:
        """The lines that begin with a word; `prefix`: the word, followed by spaces up to three bytes."""
        width = len(prefix.rstrip()) + 1
        fits = [self.data[self.starts + k] == prefix[k] for k in range(width)]
        return np.flatnonzero(np.logical_and.reduce(fits))

    def text(self, rows: NDArray[np.int64]) -> bytes:
        """Lines without their first word, each with its newline."""
        if not len(rows):
            return b""
        start = self.starts[rows[0]]
        text = self.data[start : self.ends[rows[-1]] + 1].copy()
        for k in range(int(np.argmax(text == _SPACE))):  # the letters of the word
            text[self.starts[rows] - start + k] = _SPACE
        breaks = np.flatnonzero(np.diff(rows) != 1)  # between runs of consecutive lines
        first, last = rows[np.append(0, breaks + 1)], rows[np.append(breaks, len(rows) - 1)]
        spans = zip((self.starts[first] - start).tolist(), (self.ends[last] + 1 - start).tolist())
        return b"".join(text.data[i:k] for i, k in spans)

    def line(self, row: int) -> bytes:
        return self.data[self.starts[row] : self.ends[row]].tobytes()


def _lines_of(data: bytes) -> _FileLines:
    if b"\\" in data:
        data = re.sub(rb"\\\r?\n", b" ", data)
    if any(each in data for each in _IRREGULAR):
        data = re.sub(rb"[\t\v\f ]+", b" ", data.replace(b"\r\n", b"\n").replace(b"\r", b"\n"))
        data = re.sub(rb" ?\n ?", b"\n", data)
    data_bytes = np.frombuffer(data.lstrip(b" ") + b"\n\0\0\0", np.uint8)
    ends = np.flatnonzero(data_bytes == _NEWLINE)
    return _FileLines(data_bytes, np.append(0, ends[:-1] + 1), ends)


def _numbers(lines: _FileLines, rows: NDArray[np.int64], kind: str, file: str) -> NDArray[np.float64]:
    """(n, k) float64: the numbers on lines of a kind, k of the shortest one."""
    text = lines.text(rows)
    columns = len(text[: text.find(b"\n")].split())
    values = parsed_numbers(text, np.float64)
    if values is not None and len(values) == len(rows) * columns and (_words_per_line(text) == columns).all():
        return values.reshape(len(rows), columns)
    words = [line.partition(b"#")[0].split() for line in text.splitlines()]
    lengths = [*map(len, words)]
    columns = min(lengths)
    if columns < max(lengths) and columns < _NUMBERS[kind]:
        row = lines.first + rows[lengths.index(columns)] + 1
        raise InputError(
            f"{file}: line {row}, of {kind}, has {counted(columns, 'number')}, and others {max(lengths)}; {_CURE}"
        )
    try:
        return np.array([[float(word) for word in row[:columns]] for row in words], np.float64)
    except ValueError as error:
        raise InputError(f"{file}: cannot be read ({error}); {_CURE}") from None


def _words_per_line(text: bytes) -> NDArray[np.int64]:
    """(n,) int64: the number of words on each line of a text without other white space than spaces."""
    data = np.frombuffer(text, np.uint8)
    is_newline = data == _NEWLINE
    inside = (data != _SPACE) & ~is_newline
    starts = np.cumsum(inside & ~np.append(False, inside[:-1]))
    return np.asarray(np.diff(starts[is_newline], prepend=0))


# --- Objects, materials and groups of faces ---------------------------------------------------------------------------


class _Heads(NamedTuple):
    """The lines that name objects, materials and their files."""

    name: str  # of meshes without materials
    libraries: list[str]  # files of materials
    rows: NDArray[np.int64]  # (k,) int64, ascending: the lines that begin a material
    materials: list[str]  # their names

    @classmethod
    def of_lines(cls, lines: _FileLines, file: str) -> "_Heads":
        words: dict[bytes, list[tuple[int, str]]] = {b"usemtl": [], b"mtllib": [], b"o": []}
        first = lines.data[lines.starts]
        for row in np.flatnonzero((first == ord("u")) | (first == ord("m")) | (first == ord("o"))).tolist():
            word, _, rest = lines.line(row).partition(b" ")
            if word in words:
                words[word].append((row, decoded_text(rest).strip()))
        starts = np.concatenate([lines.rows(b"f  ")[:1], *([row] for row, _ in words[b"usemtl"][:1])])
        names = [name for row, name in words[b"o"] if not len(starts) or row < starts.min()]
        rows = np.array([row for row, _ in words[b"usemtl"]], np.int64)
        materials = [name for _, name in words[b"usemtl"]]
        return cls(names[0] if names else "geometry", [name for _, name in words[b"mtllib"]], rows, materials)

    def groups(self, rows: NDArray[np.int64], before: str | None) -> Iterator[tuple[str | None, NDArray[np.int64]]]:
        """The faces on lines `rows`, by material, the last material first; `before`: that before the first head."""
        names = dict.fromkeys([before, *self.materials])
        number = {name: k for k, name in enumerate(names)}
        of_head = np.array([0, *(number[name] for name in self.materials)])
        of_face = of_head[np.searchsorted(self.rows, rows)]
        order = np.argsort(of_face, kind="stable")
        parts = np.split(order, np.flatnonzero(np.diff(of_face[order])) + 1) if len(order) else []
        by_first = sorted(parts, key=lambda part: int(part[0]), reverse=True)
        listed = list(names)
        yield from ((listed[of_face[part[0]]], part) for part in by_first)


class MeshNames:
    """Distinct names of meshes: those of their materials, if a file has several; else name, name_1, name_2 ..."""

    def __init__(self, name: str, by_material: bool) -> None:
        self._by_material, self._numbered, self._used = by_material, _numbered(name), set[str]()

    def of(self, material: str | None) -> str:
        """The name of the next mesh."""
        wanted = iter([material]) if self._by_material and material else iter(())
        name = next(name for names in (wanted, self._numbered) for name in names if name not in self._used)
        self._used.add(name)
        return name


def _numbered(name: str) -> Iterator[str]:
    """Names such as name, name_1, name_2; or part_7, part_8."""
    if name:
        yield name
    stem, mark, number = name.rpartition("_")
    is_numbered = bool(mark) and number.isdecimal()
    stem, last = (stem, int(number)) if is_numbered else (name or "geometry", 0)
    yield from (f"{stem}_{i}" for i in count(last + 1))


# --- Faces ------------------------------------------------------------------------------------------------------------


class _PolygonTriangles(NamedTuple):
    """The triangles of all polygons, in the order of the file."""

    corners: NDArray[np.int64]  # (n, 3, 3) int64: vertex, texture coordinates and normal of each corner; -1: none
    line: NDArray[np.int64]  # (n,) int64: index of the line among those of faces


def _triangles(
    lines: _FileLines, rows: dict[str, NDArray[np.int64]], file: str, earlier: tuple[int, ...]
) -> _PolygonTriangles:
    text = lines.text(rows["f"])
    text = re.sub(rb"#[^\n]*", b"", text) if b"#" in text else text
    data = np.frombuffer(text, np.uint8)
    inside = (data != _SPACE) & (data != _NEWLINE)
    tokens = np.flatnonzero(inside & ~np.append(False, inside[:-1]))
    sides = np.diff(np.searchsorted(tokens, np.flatnonzero(data == _NEWLINE)), prepend=0)
    of_line = np.repeat(np.arange(len(sides)), sides)
    corners = _corners(text, data, tokens, file)
    if (corners[:, 0] == 0).any():
        row = lines.first + rows["f"][of_line[np.argmax(corners[:, 0] == 0)]] + 1
        raise InputError(f"{file}: line {row} uses vertex 0; OBJ counts vertices from 1, {_CURE}")
    if (corners < 0).any():  # counted back from the line
        before = [n + np.searchsorted(rows[kind], rows["f"])[of_line] for n, kind in zip(earlier, _NUMBERS)]
        corners = np.where(corners < 0, corners + np.stack(before, 1) + 1, corners)
    corners, first = corners - 1, np.cumsum(sides) - sides
    n = np.maximum(sides - 2, 0)
    line = np.repeat(np.arange(len(n)), n)
    step = np.arange(len(line)) - (np.cumsum(n) - n)[line]
    fan = first[line][:, None] + np.stack([0 * step, step + 1, step + 2], 1)
    return _PolygonTriangles(corners[fan], line)


def _corners(text: bytes, data: NDArray[np.uint8], tokens: NDArray[np.int64], file: str) -> NDArray[np.int64]:
    """(n, 3) int64: the numbers of each token v, v/vt, v//vn or v/vt/vn, as in the file; 0: none.

    tokens : (n,) int64: their first bytes in the text, whose bytes are `data`
    """
    values = parsed_numbers(text.replace(b"/", b" "), np.int64)
    slashes = np.flatnonzero(data == _SLASH)
    owner = np.searchsorted(tokens, slashes, "right") - 1
    n_slashes = np.bincount(owner, minlength=len(tokens))
    ends = np.take(data, slashes + 1)  # the byte after each slash
    is_first = np.append(True, owner[1:] != owner[:-1])[: len(owner)]
    has_uv, has_normal = np.zeros(len(tokens), bool), np.zeros(len(tokens), bool)
    numbered = (ends != _SLASH) & (ends != _SPACE) & (ends != _NEWLINE)
    has_uv[owner[is_first & numbered]] = True
    has_normal[owner[~is_first & numbered]] = True
    width = 1 + has_uv.astype(np.int64) + has_normal
    if values is None or len(values) != width.sum() or (n_slashes > 2).any():
        raise InputError(f"{file}: the faces cannot be read, they hold something other than numbers; {_CURE}")
    if not len(slashes):
        return np.stack([values, 0 * values, 0 * values], 1)
    if (width == 3).all():
        return values.reshape(-1, 3)
    first = np.cumsum(width) - width
    uv = np.where(has_uv, values[np.minimum(first + 1, len(values) - 1)], 0)
    return np.stack([values[first], uv, np.where(has_normal, values[first + width - 1], 0)], 1)


# --- Meshes -----------------------------------------------------------------------------------------------------------


class NumberRows(Protocol):
    """(n, k) float64, in memory or in a file."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    def __len__(self) -> int: ...

    def __getitem__(self, numbers: Any) -> NDArray[np.float64]:
        """The rows with these numbers."""
        ...


class ObjAttributes(NamedTuple):
    """The vertex data of a file."""

    vertices: NumberRows  # positions; with six columns or more, also sRGB colours in [0, 1]
    uv: NumberRows  # v up
    normals: NumberRows
    file: str

    @classmethod
    def of_numbers(cls, numbers: Sequence[NumberRows], has_faces: bool, file: str) -> "ObjAttributes":
        """From the numbers of `ObjPart`."""
        vertices, uv, normals = numbers
        if len(vertices) and has_faces and vertices.shape[1] < _NUMBERS["v"]:
            raise InputError(f"{file}: has vertices of {counted(vertices.shape[1], 'number')}; a vertex is x y z")
        return cls(vertices, uv, normals, file)

    def columns_of(self, least: NDArray[np.int64], most: NDArray[np.int64]) -> list[int]:
        """The columns of corners that count: 0, and those of attributes that all corners have.

        least, most : (3,) the least and largest number in each column
        """
        has_uv = least[1] >= 0 and most[1] < len(self.uv) and self.uv.shape[1] >= _NUMBERS["vt"]
        has_normals = least[2] >= 0 and most[2] < len(self.normals) and self.normals.shape[1] == _NUMBERS["vn"]
        return [0, *([1] if has_uv else []), *([2] if has_normals else [])]

    def mesh(
        self, name: str, corners: NDArray[np.int64], material: Material | None, used: list[int] | None = None
    ) -> Mesh:
        """A mesh of triangles, (f, 3, 3) int64 as `_PolygonTriangles.corners`; `used`: its `columns_of`."""
        where = f'{self.file}: mesh "{name}"'
        least, most = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        if least[0] < 0 or most[0] >= len(self.vertices):
            raise InputError(f"{where}: a face uses a missing vertex; {_CURE}")
        used = self.columns_of(least, most) if used is None else used
        chosen, faces = _distinct(corners.reshape(-1, 3)[:, used])
        vertex, uv_row, normal_row = corners.reshape(-1, 3)[chosen].T
        vertices = self.vertices[vertex]
        uv = flip_v(self.uv[uv_row][:, :2], len(chosen)) if 1 in used else None
        normals = self.normals[normal_row] if 2 in used else None
        colours = None
        if material is None and uv is None and vertices.shape[1] >= 6:
            colours = np.round(np.clip(np.nan_to_num(vertices[:, 3:6], posinf=0.0), 0.0, 1.0) * 255.0)
        mesh = make_mesh(name, vertices[:, :3], faces, None, where)
        attributes = VertexAttributes(uv, None if colours is None else colours.astype(np.uint8), normals)
        return textured_mesh(mesh, faces, len(chosen), material or PLAIN, where, attributes)


def _distinct(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(a row of each distinct key, ascending; (n / 3, 3): the number of each row's key). keys : (n, 1, 2 or 3)."""
    key = keys[:, 0]
    if not (keys == key[:, None]).all():
        if keys.shape[1] == 3:  # products of three numbers could overflow
            key = np.unique(key * (int(keys[:, 1].max()) + 1) + keys[:, 1], return_inverse=True)[1]
        key = key * (int(keys[:, -1].max()) + 1) + keys[:, -1]
    upper = int(key.max()) + 1
    if upper > 4 * len(key):
        _, rows, inverse = np.unique(key, return_index=True, return_inverse=True)
        return rows, inverse.reshape(-1, 3)
    row_of = np.full(upper, -1, np.int64)
    row_of[key[::-1]] = np.arange(len(key))[::-1]  # the first row of each key
    number = np.cumsum(row_of >= 0) - 1
    return row_of[row_of >= 0], number[key].reshape(-1, 3)


# --- MTL files: materials, and the files beside a scene that they may refer to ----------------------------------------


_MAX_BYTES = 1 << 28
_OPTIONS = re.compile(r"^(?:-(?:[ost]\s+\S+\s+\S+\s+\S+|mm\s+\S+\s+\S+|\w+\s+\S+)\s+)+")  # before a texture's name


class SideFiles:
    """Files of materials and textures, read from a scene's folder only. Each failure adds a note."""

    def __init__(self, folder: Path, file: str) -> None:
        self.file = file
        self.notes: list[str] = []
        self._folder = folder

    def read(self, name: str, instead: str) -> bytes | None:
        """The contents of a file; None, with a note that ends with what happens instead, if it cannot be read."""
        where = f"{self.file}: file {_bare(name)[:80]!r}"
        try:
            path = checked_file(self._sibling(name), where)
            if path.stat().st_size > _MAX_BYTES:
                raise InputError(f"{where} is too large")
            return path.read_bytes()
        except (InputError, OSError) as error:
            self.notes.append(f"{error} ({instead})")
            return None

    def path_of(self, name: str) -> Path | None:
        """The path of a file, which may be missing; None: it is beyond the scene's folder."""
        try:
            return self._sibling(name)
        except InputError:
            return None

    def _sibling(self, name: str) -> Path:
        return sibling(self._folder, _bare(name), f"{self.file}: file")


def _bare(name: str) -> str:
    """The name of a file, without the options of a texture."""
    return _OPTIONS.sub("", name.strip()).replace("\\", "/")


def texture_names(library: bytes) -> list[str]:
    """The textures in an MTL file, with their options."""
    fields = _fields_of(decoded_text(library)).values()
    return [each[key] for each in fields for key in ("map_kd", "map_d") if key in each]


def read_materials(libraries: Iterable[str], files: SideFiles) -> dict[str | None, Material]:
    """The materials in MTL files, by name: Kd (linear), d or Tr, Ke, Pm and Pr, with map_Kd, map_d, map_Ke and norm."""
    fields = dict[str, dict[str, str]]()
    for library in dict.fromkeys(libraries):
        data = files.read(library, "its materials are white")
        if data is not None:
            fields.update(_fields_of(decoded_text(data)))
    names = [(each.get("map_kd", ""), each.get("map_d", "")) for each in fields.values()]
    textures = _read_textures([pair for pair in dict.fromkeys(names) if any(pair)], files)
    maps = _Maps(files)
    out: dict[str | None, Material] = {
        name: _material(name, each, textures.get(pair), maps) for (name, each), pair in zip(fields.items(), names)
    }
    if left := sorted({what for each in fields.values() for word, what in _LEFT_OUT.items() if word in each}):
        files.notes.append(f"{files.file}: materials: left out: {', '.join(left)}")
    return out


_LEFT_OUT = {"bump": "bump maps", "map_bump": "bump maps"}
_LEFT_OUT |= {"map_pm": "maps of metalness and roughness", "map_pr": "maps of metalness and roughness"}
_BRIGHTEST = 1e30  # the limit of intensities
_SCALE = re.compile(r"(?:^|\s)-bm\s+(\S+)")  # of a normal map


class _Maps:
    """The textures of materials besides their base colours. Files that cannot be used are left out with a note."""

    def __init__(self, files: SideFiles) -> None:
        self._files = files
        self._found: dict[tuple[str, bool], TextureMap | None] = {}

    def map_of(self, line: str, holds_data: bool) -> TextureMap | None:
        """The texture that a line names; None without one."""
        if not line:
            return None
        if (line, holds_data) not in self._found:
            self._found[line, holds_data] = self._read(line, holds_data)
        return self._found[line, holds_data]

    def _read(self, line: str, holds_data: bool) -> TextureMap | None:
        data, name = self._files.read(line, "left out"), _OPTIONS.sub("", line)
        if data is None:
            return None
        try:
            checked_size(data)
        except ValueError as error:
            self._files.notes.append(f"{self._files.file}: texture {name[:80]!r} is unusable ({error}); left out")
            return None
        return TextureMap(Texture(f"{self._files.file}: {name}", data, holds_data=holds_data))


def _pbr_of(fields: dict[str, str], maps: _Maps) -> PbrParameters | None:
    """Emission (Ke), normal map (norm), metalness (Pm) and roughness (Pr); None for a diffuse surface."""
    emission, bump = _channels(fields.get("ke", ""), _BRIGHTEST), fields.get("norm", "")
    metallic, roughness, scale = _channels(fields.get("pm", "")), _channels(fields.get("pr", "")), _SCALE.search(bump)
    r, g, b = emission[:3] if len(emission) >= 3 else emission[:1] * 3 or [float("map_ke" in fields)] * 3
    pbr = PbrParameters(
        metallic=metallic[0] if metallic else 0.0,
        roughness=roughness[0] if roughness else 1.0,
        normal_map=maps.map_of(bump, True),
        normal_scale=(_channels(scale[1], _BRIGHTEST) or [1.0])[0] if scale else 1.0,
        emission=(r, g, b),
        emission_map=maps.map_of(fields.get("map_ke", ""), False) if any((r, g, b)) else None,
    )
    return None if pbr.is_plain else pbr


def decoded_text(data: bytes) -> str:
    """A text in UTF-8, else in Windows-1252: names in an OBJ file and its MTL files must be decoded alike."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _fields_of(text: str) -> dict[str, dict[str, str]]:
    """Name of a material -> its lines: the first word, in lower case -> the rest."""
    materials, current = dict[str, dict[str, str]](), dict[str, str]()
    for line in text.splitlines():
        word, *rest = line.split(maxsplit=1)[:2] or [""]
        if word.lower() == "newmtl" and rest:
            current = materials.setdefault(" ".join(rest[0].split()), {})
        elif rest:
            current[word.lower()] = rest[0].strip()
    return materials


def _material(name: str, fields: dict[str, str], texture: Texture | None, maps: _Maps) -> Material:
    diffuse = _channels(fields.get("kd", ""))
    r, g, b = diffuse[:3] if len(diffuse) >= 3 else diffuse[:1] * 3 or [1.0] * 3
    opacity, clearness = _channels(fields.get("d", "")), _channels(fields.get("tr", ""))
    alpha = opacity[-1] if opacity else 1.0 - clearness[-1] if clearness and "d" not in fields else 1.0
    mode = MASK if texture is not None and texture.has_alpha else BLEND if alpha < 1.0 else OPAQUE
    material = Material(name, (r, g, b, alpha), texture, mode, pbr=_pbr_of(fields, maps))
    lost = "map_kd" in fields and (texture is None or texture.picture is None)
    return without_texture(material) if lost else material


def _channels(text: str, most: float = 1.0) -> list[float]:
    """The numbers among the words of a line, clamped to [0, most]."""
    numbers = list[float]()
    for word in text.split():
        try:
            value = float(word)
        except ValueError:  # such as -halo
            continue
        if not np.isnan(value):
            numbers.append(min(max(value, 0.0), most))
    return numbers


def _read_textures(names: list[tuple[str, str]], files: SideFiles) -> dict[tuple[str, str], Texture]:
    """(file of the colour, file of the opacity) -> texture, decoded on all cores; unusable files are left out."""
    colours = {colour for colour, _ in names}
    files_named = dict.fromkeys(name for pair in names for name in pair if name)
    data = {name: files.read(name, "shown in pink" if name in colours else "left out") for name in files_named}

    def texture(colour: str, opacity: str) -> Texture:
        alpha = data.get(opacity)
        return Texture(f"{files.file}: {colour or opacity}", data.get(colour), has_alpha=bool(alpha), opacity=alpha)

    def error_of(texture: Texture) -> str | None:
        try:
            texture.preview_levels  # noqa: B018  # decodes it
        except ValueError as error:
            return str(error)
        return None

    usable = [pair for pair in names if any(data.get(name) for name in pair)]
    of_bytes = dict[tuple[bytes | None, bytes | None], Texture]()  # files may have several names
    textures = {pair: of_bytes.setdefault((data.get(pair[0]), data.get(pair[1])), texture(*pair)) for pair in usable}
    check_textures(of_bytes.values(), files.file)
    found = dict(zip(of_bytes, map_in_threads(error_of, of_bytes.values())))
    errors = {pair: found[data.get(pair[0]), data.get(pair[1])] for pair in usable}
    for pair in [pair for pair, error in errors.items() if error is not None]:
        for name in pair:  # find the file that cannot be decoded
            if data.get(name) and (error := error_of(texture(name, ""))) is not None:
                files.notes.append(
                    f"{files.file}: texture {name[:80]!r} is unusable ({error}); "
                    + ("shown in pink" if name in colours else "left out")
                )
                data[name] = None
        textures[pair] = texture(*pair)
    return {pair: each for pair, each in textures.items() if each.picture is not None or each.opacity is not None}


# --- Writing ----------------------------------------------------------------------------------------------------------


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
