"""OBJ files larger than memory: one pass writes numbers and corners to scratch files, from which pieces are read.

The faces of a material form a group, as in memory. Its segments, one of each part of the file, follow one another.
"""

import shutil
import weakref
from collections.abc import Generator, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.files import temporary_folder
from ..scene.materials import Material
from ..scene.mesh import MeshInfo, ObjectInfo, Piece
from .face_ranges import FACES_PER_PIECE, FileRows
from .obj_file import MeshNames, NumberRows, ObjAttributes, ObjPart, PartSummary, SideFiles, notes_on, read_materials

_PART = 1 << 22  # bytes of the file that are parsed at once
_CORNERS = np.dtype((np.int32, (3, 3)))


class _ScratchRows:
    """Rows of numbers in a scratch file; all have the same columns."""

    def __init__(self, path: Path):
        self._path, self.shape = path, (0, 0)

    def append(self, rows: NumberRows) -> bool:
        """Write rows; False if they have other columns than earlier ones."""
        if len(rows):
            if len(self) and rows.shape[1] != self.shape[1]:
                return False
            with self._path.open("ab") as stream:
                stream.write(np.ascontiguousarray(rows).data)
            self.shape = len(self) + len(rows), rows.shape[1]
        return True

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, numbers: Any) -> NDArray[np.float64]:
        used, inverse = np.unique(numbers, return_inverse=True)
        rows = FileRows(self._path, np.dtype((np.float64, self.shape[1:])), 0)
        out: NDArray[np.float64] = rows[used][inverse]
        return out


class _MaterialGroup:
    """The triangles of a material."""

    def __init__(self) -> None:
        self.segments = list[tuple[int, int]]()  # first triangle in the scratch file, and number of triangles
        self.least, self.most = np.full(3, np.iinfo(np.int64).max), np.full(3, -1)  # numbers of corners
        self.is_one = np.ones(3, np.bool_)  # whether each column of the corners is the first one

    @property
    def n(self) -> int:
        return sum(n for _, n in self.segments)

    def add(self, first: int, corners: NDArray[np.int64]) -> None:
        self.segments.append((first, len(corners)))
        self.least = np.minimum(self.least, corners.min(axis=(0, 1)))
        self.most = np.maximum(self.most, corners.max(axis=(0, 1)))
        self.is_one &= (corners == corners[..., :1]).all(axis=(0, 1))

    def ranges(self) -> Iterator[NDArray[np.int64]]:
        """Yield the triangles' numbers in the scratch file, a piece at a time."""
        for first, n in self.segments:
            for start in range(first, first + n, FACES_PER_PIECE):
                yield np.arange(start, min(start + FACES_PER_PIECE, first + n))


class _ScratchFiles:
    """The scratch files of a file, which are filled part by part."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.numbers = [_ScratchRows(folder / kind) for kind in ("v", "vt", "vn")]
        self.groups = dict[str | None, _MaterialGroup]()  # by material, in the order of their first faces
        self.libraries, self.name, self.n_lines = list[str](), "geometry", 0
        self.summaries = list[PartSummary]()
        self._material: str | None = None
        self._n_triangles = 0

    def add(self, text: bytes, file: str) -> bool:
        """Add whole lines of a file; False if its numbers have other columns than earlier ones."""
        part = ObjPart.of_text(text, file, self.n_lines, tuple(map(len, self.numbers)))
        if not all([rows.append(more) for rows, more in zip(self.numbers, part.numbers)]):
            return False
        with (self.folder / "corners").open("ab") as stream:
            for material, corners in reversed(list(part.groups(self._material))):
                stream.write(np.ascontiguousarray(corners, np.int32).data)
                self.groups.setdefault(material, _MaterialGroup()).add(self._n_triangles, corners)
                self._n_triangles += len(corners)
        self._material = part.heads.materials[-1] if part.heads.materials else self._material
        self.libraries += part.heads.libraries
        self.n_lines += part.n_lines
        self.summaries.append(part.summary)
        return True


class ObjStream:
    """The source of an OBJ file in scratch files, which are removed with it. It never moves."""

    duration = 0.0
    in_memory = False

    def __init__(self, file: str, scratch: _ScratchFiles, names: list[str], materials: list[Material | None]):
        self.file, self._materials, self._names = file, materials, names
        self._groups = list(reversed(scratch.groups.values()))  # the last material first
        self._corners = FileRows(scratch.folder / "corners", _CORNERS, 0)
        self._attributes = ObjAttributes.of_numbers(scratch.numbers, bool(self._groups), file)
        self.meshes = [MeshInfo(name, group.n, 1) for name, group in zip(names, self._groups)]
        self.objects = [ObjectInfo(name, k, 0) for k, name in enumerate(names)]

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        for k, (group, name, material) in enumerate(zip(self._groups, self._names, self._materials)):
            used = self._attributes.columns_of(group.least, group.most)
            where = f'{self.file}: mesh "{name}"'
            for numbers in group.ranges():
                corners = self._corners[numbers].astype(np.int64)
                mesh = self._attributes.mesh(name, corners, material, used)
                # A vertex is a row of all columns, which has no number unless they are equal.
                vertices = np.unique(corners[..., 0]) if group.is_one[used].all() else None
                yield Piece(
                    mesh.positions[None], mesh.faces, mesh.colour, where, first=k, look=mesh.look,
                    is_range=len(numbers) < group.n, numbers=vertices,
                )  # fmt: skip

    def cameras(self, time: float) -> list[Any]:
        return []

    def lights(self, time: float) -> list[Any]:
        return []


def stream_obj(path: Path) -> tuple[ObjStream, list[str]] | None:
    """(source, notes) for an .obj file, as `read_obj`.

    None if it must be read whole, because lines of one kind have different columns, or there are no faces.
    """
    size, files = path.stat().st_size, SideFiles(path.parent, path.name)
    with ExitStack() as stack:
        folder = stack.enter_context(temporary_folder())
        if shutil.disk_usage(folder).free < size:
            room = f"has no room for the numbers of {path.name} ({size >> 20} MiB); set TMPDIR"
            raise InputError(f"{folder.parent}: {room}")
        scratch = _ScratchFiles(folder)
        if not all(scratch.add(text, path.name) for text in texts_of(path)) or not scratch.groups:
            return None
        materials = read_materials(scratch.libraries, files)
        groups, names = list(reversed(scratch.groups)), MeshNames("geometry", len(materials) > 1)
        meshes = [names.of(material) if len(groups) > 1 else path.stem for material in groups]
        source = ObjStream(path.name, scratch, meshes, [materials.get(material) for material in groups])
        weakref.finalize(source, stack.pop_all().close)
    return source, files.notes + notes_on(scratch.summaries, scratch.numbers, path.name)


def texts_of(path: Path) -> Iterator[bytes]:
    """Yield a file in parts of whole lines, without the end of the last one."""
    with path.open("rb") as stream:
        rest = b""
        while data := stream.read(_PART):
            data = rest + data
            end = data.rfind(b"\n")
            while end > 0 and data[:end].endswith((b"\\", b"\\\r")):  # the next line continues it
                end = data.rfind(b"\n", 0, end)
            if end >= 0:
                yield data[:end].removesuffix(b"\r")
            rest = data[end + 1 :]
        if rest:
            yield rest
