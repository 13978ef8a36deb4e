"""Spools the pieces of scenes to a temporary file, in their own precision, until all pieces are known."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import NamedTuple

import numpy as np

from ..scene.source import Piece
from ..scene.survey import Survey, faces_of
from .layout import index_dtype
from .palette import palette_of

MOST = 1 << 18
"""The most faces of a piece in the spool."""


class _Array(NamedTuple):
    """An array in the file."""

    offset: int
    shape: tuple[int, ...]
    dtype: np.dtype


class _Spooled(NamedTuple):
    """A `Piece` whose arrays are in the file."""

    vertices: _Array
    faces: _Array | None
    colour: tuple[_Array, _Array | None]  # palette, and the row of each face; None: the palette is the colour itself
    where: str


class Spool:
    """Pieces in order, in a temporary file without a name, and their survey.

    Read them only when no piece is being added.
    """

    def __init__(self, folder: Path, file: str):
        self.survey = Survey(file)
        self._stream = TemporaryFile(dir=folder)  # noqa: SIM115 - closed by `close`
        self._pieces: list[_Spooled] = []

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return self._stream.tell()

    def add(self, piece: Piece) -> None:
        """Write a piece; a large piece is split."""
        self.survey.add(piece)
        for part in _parts(piece, MOST):
            self._pieces.append(self._written(part))

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
        with suppress(OSError):  # buffered data is not needed any more, so a full disk does not matter
            self._stream.close()

    def _written(self, piece: Piece) -> _Spooled:
        dtype = np.float32 if piece.vertices.dtype == np.float32 else np.float64
        vertices = self._write(np.ascontiguousarray(piece.vertices, dtype))
        faces = None if piece.faces is None else self._write(np.ascontiguousarray(piece.faces, np.int32))
        if piece.colour.ndim == 1:
            return _Spooled(vertices, faces, (self._write(piece.colour), None), piece.where)
        palette, index = palette_of(piece.colour)
        index = index.astype(index_dtype(len(palette)))
        return _Spooled(vertices, faces, (self._write(palette), self._write(index)), piece.where)

    def _write(self, array: np.ndarray) -> _Array:
        place = _Array(self._stream.tell(), array.shape, array.dtype)
        self._stream.write(array.data if array.size else b"")
        return place

    def _read(self, place: _Array) -> np.ndarray:
        array = np.empty(place.shape, place.dtype)
        self._stream.seek(place.offset)
        read_into(self._stream, array)
        return array


def read_into(stream, array: np.ndarray) -> None:
    """Fill a C-contiguous array from a stream; OSError if the stream is too short."""
    if stream.readinto(array.reshape(-1).view(np.uint8).data) != array.nbytes:
        raise OSError("a temporary file has lost its end")


def _parts(piece: Piece, most: int) -> Iterator[Piece]:
    """Split a piece into pieces of at most `most` faces; faces keep their order."""
    copies, n = len(piece.vertices), faces_of(piece)
    if n == 0:
        return
    if n <= most:
        step = most // n
        for first in range(0, copies, step):
            yield piece._replace(vertices=piece.vertices[first : first + step])
        return
    for copy in range(copies):
        for first in range(0, n, most):
            yield _run(piece, copy, first, min(first + most, n))


def _run(piece: Piece, copy: int, first: int, last: int) -> Piece:
    """Faces `first` to `last` - 1 of a copy, with the vertices that they use."""
    vertices, colour = piece.vertices[copy], piece.colour
    if colour.ndim > 1:
        colour = colour[first:last]
    if piece.faces is None:
        return Piece(vertices[None, 3 * first : 3 * last], None, colour, piece.where)
    used, faces = np.unique(piece.faces[first:last], return_inverse=True)
    return Piece(vertices[used][None], faces.reshape(-1, 3).astype(np.int32), colour, piece.where)
