"""Files of which any bytes, rows or faces can be read: streams of pieces, for stores."""

from collections.abc import Generator
from io import FileIO
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..scene.mesh import Mesh, MeshInfo, ObjectInfo, Piece

FACES_PER_PIECE = 1 << 18
"""What a store stages at a time."""

PIECES_PER_SPAN = 8

BINARY_PLY = "convert it to binary PLY, which is streamed"
"""The cure for meshes that are too large to be read whole."""

_WINDOW = 1 << 24  # bytes read at once, at most
_GAP = 1 << 12  # bytes between rows that are read rather than skipped


class FileBytes:
    """Bytes of a file, which are read as they are needed. A slice of them is not read yet.

    They are not mapped: a file that shrinks would end the process.
    """

    def __init__(self, path: Path, offset: int = 0, size: int | None = None):
        self._path, self._offset = path, offset
        self._size = path.stat().st_size - offset if size is None else size

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, part: slice) -> "FileBytes":
        first, last, _ = part.indices(self._size)
        return FileBytes(self._path, self._offset + first, max(last - first, 0))

    def __bytes__(self) -> bytes:
        return self.read().tobytes()

    def read(self) -> NDArray[np.uint8]:
        out = np.empty(self._size, np.uint8)
        with self._path.open("rb", buffering=0) as stream:
            read_at(stream, self._offset, out)
        return out

    def rows(self, dtype: np.dtype[Any], stride: int) -> "FileRows":
        """The bytes as rows, `stride` bytes apart."""
        return FileRows(self._path, dtype, self._offset, stride)


def read_at(stream: FileIO, offset: int, out: NDArray[np.uint8]) -> None:
    """Fill an array from `offset` on. Raises InputError if the file is too short."""
    stream.seek(offset)
    filled, view = 0, out.data
    while filled < len(out):  # Linux reads at most 2 GiB at once
        n = stream.readinto(view[filled:])
        if not n:
            raise InputError(f"{Path(str(stream.name)).name}: was cut short while it was read; copy the file again")
        filled += n


class FileRows:
    """Rows of one type in a file.

    Parameters
    ----------
    dtype : of a row
    offset : bytes before the first row
    stride : bytes from row to row; None: those of a row
    """

    def __init__(self, path: Path, dtype: np.dtype[Any], offset: int, stride: int | None = None):
        self._path, self._dtype, self._offset, self._stride = path, dtype, offset, stride or dtype.itemsize
        self._window, self._gap = max(_WINDOW // self._stride, 1), max(_GAP // self._stride, 1)

    def first(self, n: int) -> NDArray[Any]:
        """(n,): the first rows."""
        with self._path.open("rb", buffering=0) as stream:
            return self._rows(stream, 0, n).copy()

    def __getitem__(self, numbers: NDArray[np.int64]) -> NDArray[Any]:
        """(n,): the rows with these numbers, which ascend."""
        out = np.empty(len(numbers), self._dtype)
        is_break = (np.diff(numbers) > self._gap) | (np.diff(numbers // self._window) > 0)
        ends = [*(np.flatnonzero(is_break) + 1).tolist(), len(numbers)]
        with self._path.open("rb", buffering=0) as stream:
            for first, last in zip([0, *ends], ends) if len(numbers) else ():
                low = int(numbers[first])
                rows = self._rows(stream, low, int(numbers[last - 1]) + 1 - low)
                out[first:last] = rows[numbers[first:last] - low]
        return out

    def _rows(self, stream: FileIO, first: int, n: int) -> NDArray[Any]:
        block = np.empty((n - 1) * self._stride + self._dtype.itemsize, np.uint8)
        read_at(stream, self._offset + first * self._stride, block)
        return np.ndarray((n,), self._dtype, block.data, 0, (self._stride,))


class FaceRanges(Protocol):
    """The faces of a mesh in a file."""

    n_faces: int

    def mesh(self, faces: NDArray[np.int64]) -> Mesh:
        """The mesh of some faces, whose numbers ascend, with the vertices that they use."""
        ...


def n_spans(faces: FaceRanges) -> int:
    """The number of spans in which a `RangedMesh` is read."""
    return -(-faces.n_faces // (PIECES_PER_SPAN * FACES_PER_PIECE))


class RangedMesh:
    """The source of one mesh, whose faces are read range by range. It never moves.

    where : name in errors
    """

    duration = 0.0
    in_memory = False

    def __init__(self, faces: FaceRanges, name: str, file: str, where: str):
        self.file, self._faces, self._where = file, faces, where
        self.meshes, self.objects = [MeshInfo(name, faces.n_faces, 1)], [ObjectInfo(name, 0, 0)]

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        for k in range(self.n_spans):
            yield from self.span(k)

    @property
    def n_spans(self) -> int:
        return n_spans(self._faces)

    def span(self, k: int) -> Generator[Piece, None, None]:
        size, n = PIECES_PER_SPAN * FACES_PER_PIECE, self._faces.n_faces
        for first in range(k * size, min((k + 1) * size, n), FACES_PER_PIECE):
            yield self.piece_of(np.arange(first, min(first + FACES_PER_PIECE, n)))

    def piece_of(self, faces: NDArray[np.int64]) -> Piece:
        """The piece of some faces, whose numbers ascend."""
        mesh = self._faces.mesh(faces)
        is_range = len(faces) < self._faces.n_faces
        return Piece(
            mesh.positions[None], mesh.faces, mesh.colour, self._where, look=mesh.look, is_range=is_range,
            numbers=mesh.numbers,
        )  # fmt: skip

    def cameras(self, time: float) -> list[Any]:
        return []

    def lights(self, time: float) -> list[Any]:
        return []
