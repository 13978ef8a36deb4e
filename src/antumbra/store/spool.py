"""The pieces of scenes in a temporary file, in the precision they came in, until the whole is known."""

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
"""Faces of a piece in the spool, at most."""


class _Array(NamedTuple):
    """Where an array stands."""

    offset: int
    shape: tuple[int, ...]
    dtype: np.dtype


class _Spooled(NamedTuple):
    """A `Piece` whose arrays are in the file."""

    vertices: _Array
    faces: _Array | None
    colour: tuple[_Array, _Array | None]  # palette, and which row each face has; None: the palette is the colour
    where: str


class Spool:
    """Pieces of a moment at which none is on its way, in order, in a file without a name; and their survey."""

    def __init__(self, folder: Path, file: str):
        self.survey = Survey(file)
        self._stream = TemporaryFile(dir=folder)  # noqa: SIM115 - closed by `close`
        self._pieces: list[_Spooled] = []

    def add(self, piece: Piece) -> None:
        """Write a piece, cut where it is large."""
        self.survey.add(piece)
        for part in _parts(piece, MOST):
            self._pieces.append(self._written(part))

    def pieces(self) -> Iterator[Piece]:
        """All pieces; those that were cut come cut."""
        self._stream.flush()
        for vertices, faces, (palette, index), where in self._pieces:
            colour = self._read(palette)
            if index is not None:
                colour = colour[self._read(index)]
            yield Piece(self._read(vertices), None if faces is None else self._read(faces), colour, where)

    def close(self) -> None:
        """Drop the file and give back its room on the disk."""
        with suppress(OSError):  # what is not yet written need not be, if there is no room for it
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
    """Fill a C-contiguous array from a stream; OSError if there is too little."""
    if stream.readinto(array.reshape(-1).view(np.uint8).data) != array.nbytes:
        raise OSError("a temporary file has lost its end")


def _parts(piece: Piece, most: int) -> Iterator[Piece]:
    """A piece as pieces of at most so many faces, which come in the same order."""
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
    """Some faces of a copy, with the vertices that they use."""
    vertices, colour = piece.vertices[copy], piece.colour
    if colour.ndim > 1:
        colour = colour[first:last]
    if piece.faces is None:
        return Piece(vertices[None, 3 * first : 3 * last], None, colour, piece.where)
    used, faces = np.unique(piece.faces[first:last], return_inverse=True)
    return Piece(vertices[used][None], faces.reshape(-1, 3).astype(np.int32), colour, piece.where)
