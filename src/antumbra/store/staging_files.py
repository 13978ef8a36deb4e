"""Staging files of a build: scene pieces in their own precision, then columns of triangles in the recentred frame.

Columns stay in memory if they fit. Triangle colours are stored as indices into palettes. Most scenes have few colours,
so an index takes one byte.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from io import BufferedIOBase
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import kernel
from ..scene.mesh import Piece
from ..scene.scene_bounds import Survey, faces_of
from ..scene.triangle_setup import gather, rows_with_area
from .store_format import index_dtype

# --- Palettes ---------------------------------------------------------------------------------------------------------


_NONE = np.int32(-1)


@kernel
def _index(colours, table, palette, index):
    """Fill the palette with the colours, in order of occurrence, and fill the index. Return the number of colours.

    `colours` is (n, 3) int32, the bits of float32. `table` is (2**b,) int32, all -1: a hash table of more than n rows.
    """
    last, n = np.int64(len(table) - 1), 0
    for i in range(len(colours)):
        r, g, b = colours[i, 0], colours[i, 1], colours[i, 2]
        h = np.int64(r) * 73856093 ^ np.int64(g) * 19349663 ^ np.int64(b) * 83492791
        h = (h ^ h >> 13 ^ h >> 29) & last
        row = table[h]
        while row != _NONE and (palette[row, 0] != r or palette[row, 1] != g or palette[row, 2] != b):
            h = (h + 1) & last
            row = table[h]
        if row == _NONE:
            row = np.int32(n)
            table[h] = row
            palette[n, 0], palette[n, 1], palette[n, 2] = r, g, b
            n += 1
        index[i] = row
    return n


def palette_of(colours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(palette, index) of (n, 3) float32 colours. ``palette[index]`` equals the colours bit for bit."""
    n = len(colours)
    bits = np.ascontiguousarray(colours, np.float32).view(np.int32)
    table = np.full(1 << (2 * n).bit_length(), _NONE)
    palette, index = np.empty((n, 3), np.int32), np.empty(n, np.int32)
    count = _index(bits, table, palette, index)
    return palette[:count].view(np.float32), index


# --- Scene pieces, staged in a temporary file until the bounds of all are known ---------------------------------------


MAX_FACES = 1 << 18
"""Limit on the faces of a staged piece, unless a caller sets another."""


class _Array(NamedTuple):
    """An array in the file."""

    offset: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]


class _StoredPiece(NamedTuple):
    """A `Piece` whose arrays are in the file."""

    vertices: _Array
    faces: _Array | None
    colour: tuple[_Array, _Array | None]  # palette, and the row of each face; None: the palette is the colour itself
    where: str


class StagingFile:
    """Scene pieces in order, in an unnamed temporary file, and their survey.

    Do not read pieces while others are being added.

    max_faces : limit on the faces of a piece; larger ones are split
    """

    def __init__(self, folder: Path, file: str, max_faces: int = MAX_FACES):
        self.survey, self._max_faces = Survey(file), max_faces
        self._stream = TemporaryFile(dir=folder)  # noqa: SIM115 - closed by `close`
        self._pieces: list[_StoredPiece] = []

    @property
    def size(self) -> int:
        """Size of the file in bytes."""
        return self._stream.tell()

    def add(self, piece: Piece) -> None:
        """Write a piece; a large piece is split."""
        self.survey.add(piece)
        for part in _split(piece, self._max_faces):
            self._pieces.append(self._store(part))

    def pieces(self) -> Iterator[Piece]:
        """Yield all pieces; large ones stay split."""
        self._stream.flush()
        for vertices, faces, (palette, index), where in self._pieces:
            colour = self._read(palette)
            if index is not None:
                colour = colour[self._read(index)]
            yield Piece(self._read(vertices), None if faces is None else self._read(faces), colour, where)

    def close(self) -> None:
        """Delete the file."""
        with suppress(OSError):  # buffered data is no longer needed, so a full disk does not matter
            self._stream.close()

    def _store(self, piece: Piece) -> _StoredPiece:
        dtype = np.float32 if piece.vertices.dtype == np.float32 else np.float64
        vertices = self._write(np.ascontiguousarray(piece.vertices, dtype))
        faces = None if piece.faces is None else self._write(np.ascontiguousarray(piece.faces, np.int32))
        if piece.colour.ndim == 1:
            return _StoredPiece(vertices, faces, (self._write(piece.colour), None), piece.where)
        palette, index = palette_of(piece.colour)
        index = index.astype(index_dtype(len(palette)))
        return _StoredPiece(vertices, faces, (self._write(palette), self._write(index)), piece.where)

    def _write(self, array: np.ndarray) -> _Array:
        place = _Array(self._stream.tell(), array.shape, array.dtype)
        self._stream.write(array.data if array.size else b"")
        return place

    def _read(self, place: _Array) -> np.ndarray:
        array = np.empty(place.shape, place.dtype)
        self._stream.seek(place.offset)
        read_into(self._stream, array)
        return array


def read_into(stream: BufferedIOBase, array: np.ndarray) -> None:
    """Fill a C-contiguous array from a stream. Raises OSError if the stream is too short."""
    if stream.readinto(array.reshape(-1).view(np.uint8).data) != array.nbytes:
        raise OSError("a temporary file was truncated")


def _split(piece: Piece, max_faces: int) -> Iterator[Piece]:
    """Split a piece into pieces of at most `max_faces` faces; faces keep their order."""
    copies, n = len(piece.vertices), faces_of(piece)
    if n == 0:
        return
    if n <= max_faces:
        step = max_faces // n
        for first in range(0, copies, step):
            yield piece._replace(vertices=piece.vertices[first : first + step])
        return
    for copy in range(copies):
        for first in range(0, n, max_faces):
            yield _face_range(piece, copy, first, min(first + max_faces, n))


def _face_range(piece: Piece, copy: int, first: int, last: int) -> Piece:
    """Faces `first` to `last` - 1 of copy `copy`, with the vertices that they use."""
    vertices, colour = piece.vertices[copy], piece.colour
    if colour.ndim > 1:
        colour = colour[first:last]
    if piece.faces is None:
        return Piece(vertices[None, 3 * first : 3 * last], None, colour, piece.where)
    used, faces = np.unique(piece.faces[first:last], return_inverse=True)
    return Piece(vertices[used][None], faces.reshape(-1, 3).astype(np.int32), colour, piece.where)


# --- Columns of triangles, in memory or in temporary files ------------------------------------------------------------


class TriangleColumns(NamedTuple):
    """Triangles as columns: row i of each array belongs to triangle i."""

    corners: NDArray[np.float32]  # (n, 9), in the recentred frame
    ids: NDArray[np.int32]  # (n,): index in the whole scene
    colours: NDArray[np.float32]  # (n, 3)

    def rows(self, index: slice | np.ndarray) -> "TriangleColumns":
        """The rows selected by an array of indices or a slice."""
        return TriangleColumns(self.corners[index], self.ids[index], self.colours[index])


def empty_columns(n: int) -> TriangleColumns:
    """Uninitialised columns of n triangles."""
    return TriangleColumns(np.empty((n, 9), np.float32), np.empty(n, np.int32), np.empty((n, 3), np.float32))


Batches = Callable[[], Iterator[TriangleColumns]]
"""Returns a new iterator over all triangles in batches, in ascending order of ids."""


def gather_triangles(
    pieces: Iterator[Piece], origin: np.ndarray, size: int, threads: int, excluded_box: np.ndarray
) -> Iterator[TriangleColumns]:
    """Yield the triangles of nonzero area in batches of at most `size`. No piece may have more.

    The first triangle is included in any case, so that a store has a chunk. A batch is valid until the next one is
    requested.

    excluded_box : (2, 3) float32, a box that is extended by the zero-area triangles
    """
    batch, n, first = empty_columns(size), 0, 0  # number of triangles in the batch, and the id of the next one
    for piece in pieces:
        faces = faces_of(piece)
        count = len(piece.vertices) * faces
        if n + count > size:
            yield batch.rows(slice(n))
            n = 0
        rows = batch.rows(slice(n, n + count))
        gather(piece, origin, rows.corners.reshape(count, 3, 3), threads)
        rows.ids[:] = np.arange(first, first + count, dtype=np.int32)
        rows.colours.reshape(-1, faces, 3)[:] = piece.colour
        n, first = n + _compact(rows, first == 0, threads, excluded_box), first + count
    if n:
        yield batch.rows(slice(n))


def _compact(rows: TriangleColumns, first: bool, threads: int, excluded_box: np.ndarray) -> int:
    """Move the triangles of nonzero area to the front and return their number; `first`: keep row 0 as well."""
    indices = rows_with_area(rows.corners.reshape(-1, 3, 3), threads)
    if indices is None:
        return len(rows.ids)
    if first and not (len(indices) and indices[0] == 0):
        indices = np.insert(indices, 0, 0)
    corners = np.delete(rows.corners, indices, axis=0).reshape(-1, 3)
    excluded_box[0] = np.minimum(excluded_box[0], corners.min(axis=0, initial=np.inf))
    excluded_box[1] = np.maximum(excluded_box[1], corners.max(axis=0, initial=-np.inf))
    for column in rows:
        column[: len(indices)] = column[indices]
    return len(indices)


class Buckets:
    """Triangles in temporary files, in consecutive buckets whose sizes are known beforehand."""

    def __init__(self, folder: Path, sizes: np.ndarray):
        self._files = [TemporaryFile(dir=folder) for _ in TriangleColumns._fields]  # noqa: SIM115 - closed by `close`
        self._starts = np.cumsum(sizes) - sizes
        self._ends = self._starts.copy()  # end of the triangles written so far

    def add(self, bucket: int, triangles: TriangleColumns) -> None:
        """Append triangles to a bucket."""
        at = int(self._ends[bucket])
        for file, column in zip(self._files, triangles):
            file.seek(at * _row_bytes(column))
            file.write(column.data)
        self._ends[bucket] += len(triangles.ids)

    def batches(self, bucket: int, size: int) -> Iterator[TriangleColumns]:
        """Yield the triangles of a bucket in the order in which they were added, at most `size` at a time."""
        end = int(self._ends[bucket])
        for first in range(int(self._starts[bucket]), end, size):
            batch = empty_columns(min(size, end - first))
            for file, column in zip(self._files, batch):
                file.seek(first * _row_bytes(column))
                read_into(file, column)
            yield batch

    def close(self) -> None:
        """Delete the files."""
        for file in self._files:
            with suppress(OSError):  # buffered data is no longer needed, so a full disk does not matter
                file.close()


def _row_bytes(column: np.ndarray) -> int:
    return column.nbytes // len(column)
