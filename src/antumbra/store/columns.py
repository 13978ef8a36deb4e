"""Columns of triangles while a store is built, in memory or in temporary files, in the recentred frame."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import NamedTuple

import numpy as np

from ..scene.areas import with_area
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


def gathered(
    pieces: Iterator[Piece], origin: np.ndarray, size: int, threads: int, left_out: np.ndarray
) -> Iterator[Columns]:
    """Yield the triangles of pieces that have an area, in batches of at most `size`. No piece may have more.

    The first triangle is always there, so that a store has a chunk. A batch is valid until the next one is taken.

    left_out : (2, 3) float32, a box that grows around the triangles without area
    """
    batch, n, first = empty_columns(size), 0, 0  # triangles in the batch, and the number of the next one
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
        n, first = n + _keep_areas(rows, first == 0, threads, left_out), first + count
    if n:
        yield batch.rows(slice(n))


def _keep_areas(rows: Columns, first: bool, threads: int, left_out: np.ndarray) -> int:
    """Move the triangles that have an area to the front, and return their number; `first`: keep row 0, too."""
    found = with_area(rows.corners.reshape(-1, 3, 3), threads)
    if found is None:
        return len(rows.ids)
    if first and not (len(found) and found[0] == 0):
        found = np.insert(found, 0, 0)
    corners = np.delete(rows.corners, found, axis=0).reshape(-1, 3)
    left_out[0] = np.minimum(left_out[0], corners.min(axis=0, initial=np.inf))
    left_out[1] = np.maximum(left_out[1], corners.max(axis=0, initial=-np.inf))
    for column in rows:
        column[: len(found)] = column[found]
    return len(found)


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
