"""Columns of triangles while a store is built, in memory or in temporary files, in the recentred frame."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import NamedTuple

import numpy as np

from ..scene.gather import gather
from ..scene.source import Piece
from ..scene.survey import faces_of
from .spool import read_into


class Columns(NamedTuple):
    """Some triangles. A row of each array belongs to the same triangle."""

    corners: np.ndarray  # (n, 9) float32, in the recentred frame
    ids: np.ndarray  # (n,) int32: index in the whole scene
    colours: np.ndarray  # (n, 3) float32

    def rows(self, which) -> "Columns":
        """The rows that an index or a slice chooses."""
        return Columns(*(column[which] for column in self))


def empty_columns(n: int) -> Columns:
    return Columns(np.empty((n, 9), np.float32), np.empty(n, np.int32), np.empty((n, 3), np.float32))


Batches = Callable[[], Iterator[Columns]]
"""Returns a new iterator over batches of all triangles, in ascending order of their ids."""


def gathered(pieces: Iterator[Piece], origin: np.ndarray, size: int, threads: int) -> Iterator[Columns]:
    """Yield the triangles of pieces in batches of at most `size`. No piece may have more.

    A batch is valid until the next one is taken.
    """
    batch, n, first = empty_columns(size), 0, 0
    for piece in pieces:
        faces = faces_of(piece)
        count = len(piece.vertices) * faces
        if n + count > size:
            yield batch.rows(slice(n))
            first, n = first + n, 0
        gather(piece, origin, batch.corners[n : n + count].reshape(count, 3, 3), threads)
        batch.ids[n : n + count] = np.arange(first + n, first + n + count, dtype=np.int32)
        batch.colours[n : n + count].reshape(-1, faces, 3)[:] = piece.colour
        n += count
    if n:
        yield batch.rows(slice(n))


class Buckets:
    """Triangles in temporary files, in consecutive buckets. Their sizes are known beforehand."""

    def __init__(self, folder: Path, sizes: np.ndarray):
        self._files = [TemporaryFile(dir=folder) for _ in Columns._fields]  # noqa: SIM115 - closed by `close`
        self._starts = np.cumsum(sizes) - sizes
        self._ends = self._starts.copy()  # end of the triangles that have been written

    def add(self, bucket: int, triangles: Columns) -> None:
        """Append triangles to a bucket."""
        at = int(self._ends[bucket])
        for file, column in zip(self._files, triangles):
            file.seek(at * _row_bytes(column))
            file.write(column.data)
        self._ends[bucket] += len(triangles.ids)

    def batches(self, bucket: int, size: int) -> Iterator[Columns]:
        """Yield the triangles of a bucket in the order in which they were written, at most `size` at a time."""
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
            with suppress(OSError):  # buffered data is not needed any more, so a full disk does not matter
                file.close()


def _row_bytes(column: np.ndarray) -> int:
    return column.nbytes // len(column)
