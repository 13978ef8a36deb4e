"""Files of a build: scene pieces in their own precision, then columns of triangles in the recentred frame.

Triangle colours are stored as indices into palettes. Most scenes have few colours, so an index takes one byte. A file
is described by arrays, its record, which are stored separately.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from io import BufferedIOBase
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, BinaryIO, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import kernel
from ..scene.face_looks import LOOK_WIDTHS, FaceLooks
from ..scene.mesh import Piece, distinct_vertices
from ..scene.open_faces import HIDDEN, NONE_OPEN, OpenFaces
from ..scene.scene_bounds import Survey, faces_of
from ..scene.triangle_setup import gather, rows_with_area
from .staged_looks import write_looks
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


# --- Scene pieces, staged in files until the bounds of all are known --------------------------------------------------


MAX_FACES = 1 << 18
"""Limit on the faces of a staged piece, unless a caller sets another."""

Record = dict[str, np.ndarray]
"""Arrays by name, which describe a file."""

STAGED = np.dtype(
    [
        ("offset", "<i8"),  # of its arrays in the file: vertices, faces, colours and indices of colours
        ("copies", "<i8"),
        ("vertices", "<i8"),  # of a copy
        ("faces", "<i8"),  # of a copy
        ("colours", "<i8"),  # rows of the palette; 0: one colour for all faces
        ("is_single", "?"),  # whether vertices are float32, else float64
        ("is_indexed", "?"),  # whether faces index the vertices, else every three are a face
        ("open", "<i8"),  # faces that are not solid, whose numbers, masks and texture coordinates follow
        ("looks", "<i8"),  # offset of the looks of its faces, see `staged_looks`; 0: all have plain colours
        ("has", "?", len(LOOK_WIDTHS)),  # which attributes of `FaceLooks` are there
    ]
)
"""A piece in a file of staged pieces."""


MAX_RUNS = 1 << 20
"""Limit on the runs of faces of one object, and on the objects, that a store keeps."""


def object_runs(piece: Piece) -> NDArray[np.int64]:
    """(r, 2): the number of faces, and the object, of consecutive faces of one object of the source."""
    if piece.owners is None:
        objects = np.arange(piece.first, piece.first + len(piece.vertices))
        return np.stack([np.full(len(objects), faces_of(piece)), objects], 1)
    first = np.flatnonzero(np.diff(piece.owners, prepend=-1))
    return np.stack([np.diff(first, append=len(piece.owners)), piece.owners[first]], 1)


def joined_runs(runs: NDArray[np.int64]) -> NDArray[np.int64]:
    """Runs of which no two in succession are of one object, and none is empty."""
    runs = runs[runs[:, 0] > 0]
    first = np.flatnonzero(np.diff(runs[:, 1], prepend=-1))
    return np.stack([np.add.reduceat(runs[:, 0], first), runs[first, 1]], 1) if len(runs) else runs


class StagedPieces:
    """Writes scene pieces in order to a file, and surveys them.

    file : name in errors
    max_faces : limit on the faces of a piece; larger ones are split
    has_all_runs : whether the record has the objects of all faces, however many there are
    """

    def __init__(self, stream: BinaryIO, file: str, max_faces: int = MAX_FACES, has_all_runs: bool = False):
        self.survey, self._max_faces, self._stream = Survey(file), max_faces, stream
        self._has_all_runs = has_all_runs
        self._rows, self._places = list[np.ndarray](), list[str]()
        self._runs, self._n_runs = list[NDArray[np.int64]](), 0
        self.first_object = 0  # number of the first object of the scene whose pieces follow

    def add(self, piece: Piece, open_faces: OpenFaces = NONE_OPEN, looks: FaceLooks | None = None) -> None:
        """Write a piece; a large piece is split. `looks`: of its faces; None: they have plain colours."""
        self.survey.add(piece)
        runs = object_runs(piece) + np.array([0, self.first_object])
        self._n_runs += len(runs)
        if self._has_all_runs or self._n_runs <= 2 * MAX_RUNS:  # otherwise, the store keeps none
            self._runs.append(runs)
        first = 0
        for part in _split(piece, self._max_faces):
            last = first + len(part.vertices) * faces_of(part)
            row = self._write(part, open_faces.part(first, last))
            if looks is not None:
                row["looks"] = self._stream.tell()
                row["has"] = write_looks(self._stream, looks.part(first, last))
            self._rows.append(row)
            self._places.append(part.where)
            first = last

    def record(self) -> Record:
        """What `staged_pieces` needs to read the file, and `surveyed` to add the survey to another one."""
        count, box, single = self.survey.parts
        pieces = np.stack(self._rows) if self._rows else np.empty(0, STAGED)
        runs = joined_runs(np.concatenate([np.empty((0, 2), np.int64), *self._runs]))
        about = {"count": np.int64(count), "box": box, "single": np.bool_(single), "runs": runs}
        return {"pieces": pieces, "where": np.array(self._places, str), **{k: np.asarray(v) for k, v in about.items()}}

    def _write(self, piece: Piece, open_faces: OpenFaces) -> np.ndarray:
        row, is_single = np.zeros((), STAGED), piece.vertices.dtype == np.float32
        row["offset"], row["is_single"], row["is_indexed"] = self._stream.tell(), is_single, piece.faces is not None
        row["copies"], row["vertices"], row["faces"] = *piece.vertices.shape[:2], faces_of(piece)
        arrays = [np.ascontiguousarray(piece.vertices, np.float32 if is_single else np.float64)]
        if piece.faces is not None:
            arrays.append(np.ascontiguousarray(piece.faces, np.int32))
        if piece.colour.ndim == 1:
            arrays.append(np.ascontiguousarray(piece.colour, np.float32))
        else:
            palette, index = palette_of(piece.colour)
            row["colours"] = len(palette)
            arrays += [palette, index.astype(index_dtype(len(palette)))]
        row["open"] = len(open_faces.faces)
        for array in (*arrays, *open_faces):
            self._stream.write(np.ascontiguousarray(array).data)
        return row


def surveyed(survey: Survey, record: Record) -> None:
    """Add the pieces of a record to a survey."""
    survey.join(int(record["count"]), record["box"], bool(record["single"]))


def staged_pieces(path: Path, record: Record, first: int, last: int) -> Iterator[tuple[Piece, OpenFaces]]:
    """Yield the pieces `first` to `last`, exclusive, of a file of `StagedPieces`, each with its open faces."""
    with path.open("rb") as stream:
        for row, where in zip(record["pieces"][first:last], record["where"][first:last].tolist()):
            stream.seek(int(row["offset"]))
            n_faces, n_colours = int(row["faces"]), int(row["colours"])
            shape = int(row["copies"]), int(row["vertices"]), 3
            vertices = _read(stream, shape, np.float32 if row["is_single"] else np.float64)
            faces = _read(stream, (n_faces, 3), np.int32) if row["is_indexed"] else None
            colour = _read(stream, (n_colours, 3) if n_colours else (3,), np.float32)
            if n_colours:
                colour = colour[_read(stream, (n_faces,), index_dtype(n_colours))]
            m = int(row["open"])
            open_faces = _read(stream, (m,), np.int32), _read(stream, (m,), np.int32), _read(stream, (m, 3, 2), "<f4")
            yield Piece(vertices, faces, colour, where), OpenFaces(*open_faces)


def _read(stream: BinaryIO, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    array = np.empty(shape, dtype)
    read_into(stream, array)
    return array


def read_into(stream: BinaryIO, array: np.ndarray) -> None:
    """Fill a C-contiguous array from a stream. Raises OSError if the stream is too short."""
    if cast(BufferedIOBase, stream).readinto(array.reshape(-1).view(np.uint8).data) != array.nbytes:
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
    used, faces = distinct_vertices(piece.faces[first:last])
    return Piece(vertices[used][None], faces, colour, piece.where)


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


class CutoutColumns(NamedTuple):
    """Cut-outs as columns."""

    corners: NDArray[np.float32]  # (m, 9), in the recentred frame
    faces: NDArray[np.int32]  # (m,), ascending: index in the whole scene
    uv: NDArray[np.float32]  # (m, 6)
    mask: NDArray[np.int32]  # (m,); `open_faces.CLEAR`: no ray hits the face
    colours: NDArray[np.float32]  # (m, 3)


class Excluded:
    """What `gather_triangles` leaves out.

    box : (2, 3) float32
        The bounds of the triangles without area and of those that are not solid.
    """

    def __init__(self) -> None:
        self.box = np.array([[np.inf] * 3, [-np.inf] * 3], np.float32)
        none, no_numbers = np.empty(0, np.int32), np.empty((0, 18), np.float32)
        self._cutouts = [CutoutColumns(no_numbers[:, :9], none, no_numbers[:, :6], none, no_numbers[:, :3])]

    @property
    def cutouts(self) -> CutoutColumns:
        """The cut-outs, in order."""
        return CutoutColumns(*map(np.concatenate, zip(*self._cutouts)))

    def extend(self, corners: np.ndarray) -> None:
        """Extend the box by (..., 3) corners."""
        corners = corners.reshape(-1, 3)
        self.box[0] = np.minimum(self.box[0], corners.min(axis=0, initial=np.inf))
        self.box[1] = np.maximum(self.box[1], corners.max(axis=0, initial=-np.inf))

    def add(self, rows: "TriangleColumns", open_faces: OpenFaces) -> None:
        """Add the triangles of a piece that are not solid, and give them no area."""
        there = open_faces.mask != HIDDEN
        at, hidden = open_faces.faces[there], open_faces.faces[~there]
        self.extend(rows.corners[at])
        uv, mask = open_faces.uv[there].reshape(-1, 6), open_faces.mask[there]
        self._cutouts.append(CutoutColumns(rows.corners[at], rows.ids[at], uv, mask, rows.colours[at]))
        shown = np.delete(rows.corners, hidden, axis=0)[:1]
        rows.corners[hidden] = shown if len(shown) else rows.corners[hidden]  # a hidden face has no place of its own
        rows.corners[open_faces.faces] = np.tile(rows.corners[open_faces.faces, :3], 3)


def gather_triangles(
    pieces: Iterator[tuple[Piece, OpenFaces]],
    origin: np.ndarray,
    size: int,
    threads: int,
    excluded: Excluded,
    first: int = 0,
) -> Iterator[TriangleColumns]:
    """Yield the solid triangles of nonzero area in batches of at most `size`. No piece may have more.

    The first triangle of a scene is included in any case, without area if it is not solid, so that a store has a chunk.
    A batch is valid until the next one is requested.

    excluded : to which the other triangles are added
    first : id of the first triangle
    """
    batch, n = empty_columns(size), 0  # number of triangles in the batch
    for piece, open_faces in pieces:
        faces = faces_of(piece)
        count = len(piece.vertices) * faces
        if n + count > size:
            yield batch.rows(slice(n))
            n = 0
        rows = batch.rows(slice(n, n + count))
        gather(piece, origin, rows.corners.reshape(count, 3, 3), threads)
        rows.ids[:] = np.arange(first, first + count, dtype=np.int32)
        rows.colours.reshape(-1, faces, 3)[:] = piece.colour
        if len(open_faces.faces):
            excluded.add(rows, open_faces)
        n, first = n + _compact(rows, first == 0, threads, excluded), first + count
    if n:
        yield batch.rows(slice(n))


def _compact(rows: TriangleColumns, first: bool, threads: int, excluded: Excluded) -> int:
    """Move the triangles of nonzero area to the front and return their number; `first`: keep row 0 as well."""
    indices = rows_with_area(rows.corners.reshape(-1, 3, 3), threads)
    if indices is None:
        return len(rows.ids)
    if first and not (len(indices) and indices[0] == 0):
        indices = np.insert(indices, 0, 0)
    excluded.extend(np.delete(rows.corners, indices, axis=0))
    for column in rows:
        column[: len(indices)] = column[indices]
    return len(indices)


# --- Runs of triangles, sorted by cell --------------------------------------------------------------------------------


RUN = np.dtype([("offset", "<i8"), ("triangles", "<i8"), ("cells", "<i8"), ("colours", "<i8")])
"""A run in a file: the offset of its columns, and its numbers of triangles, cells and colours; 0 colours: no palette.

Its columns are corners, ids, and (n,) uint8 indices into its palette, or (n, 3) float32 colours.
"""

_PALETTE = 256


class RunWriter:
    """Writes runs of triangles, sorted by cell, to a file."""

    def __init__(self, stream: BinaryIO):
        self._stream = stream
        self._rows, self._cells, self._counts, self._palettes = (list[np.ndarray]() for _ in range(4))

    def add(self, triangles: TriangleColumns, cells: np.ndarray) -> None:
        """Write a run; `cells`: (n,) int32, ascending, n >= 1."""
        firsts = np.flatnonzero(np.append(True, np.diff(cells) != 0))
        palette, index = palette_of(triangles.colours)
        few = len(palette) <= _PALETTE
        row = np.zeros((), RUN)
        row["offset"], row["triangles"], row["cells"] = self._stream.tell(), len(cells), len(firsts)
        row["colours"] = len(palette) if few else 0
        colours = index.astype(np.uint8) if few else triangles.colours
        for column in (triangles.corners, triangles.ids, colours):
            self._stream.write(np.ascontiguousarray(column).data)
        self._rows.append(row)
        self._cells.append(cells[firsts])
        self._counts.append(np.diff(np.append(firsts, len(cells))).astype(np.int32))
        self._palettes.append(palette[: row["colours"]])

    def record(self) -> Record:
        """What `SortedRuns` needs to read the file."""
        rows = np.stack(self._rows) if self._rows else np.empty(0, RUN)
        joined = lambda parts, dtype: np.concatenate([np.empty(0, dtype), *parts])
        palettes = np.concatenate([np.empty((0, 3), np.float32), *self._palettes])
        cells, counts = joined(self._cells, np.int32), joined(self._counts, np.int32)
        return {"runs": rows, "cells": cells, "counts": counts, "palettes": palettes}


class _RunFile(NamedTuple):
    """The runs of a file."""

    path: Path
    rows: np.ndarray  # (r,) RUN
    starts: NDArray[np.int64]  # (r, buckets + 1): where each bucket begins in each run
    palettes: list[np.ndarray]


class SortedRuns:
    """The triangles of all runs by bucket, in ascending order of ids.

    files : path and record of each file
    cells : range of cells of each bucket, in order
    """

    def __init__(self, files: Iterable[tuple[Path, Record]], cells: list[tuple[int, int]]):
        bounds = np.array([*(first for first, _ in cells), cells[-1][1]])
        self._files = [_run_file(path, record, bounds) for path, record in files]

    def batches(self, bucket: int, n: int, size: int) -> Iterator[TriangleColumns]:
        """Yield the n triangles of a bucket: at once if they are at most `size`, else run by run."""
        whole, at = empty_columns(n if n <= size else 0), 0
        for file in self._files:
            chosen = np.flatnonzero(file.starts[:, bucket] < file.starts[:, bucket + 1])
            if not len(chosen):
                continue
            with file.path.open("rb", buffering=0) as stream:
                for k in chosen.tolist():
                    first, last = file.starts[k, bucket : bucket + 2].tolist()
                    part = whole.rows(slice(at, at + last - first)) if n <= size else empty_columns(last - first)
                    _read_run(cast(BinaryIO, stream), file.rows[k], file.palettes[k], first, part)
                    at += last - first
                    if n > size:
                        yield part
        if n <= size:
            yield whole


def _run_file(path: Path, record: Record, bounds: np.ndarray) -> _RunFile:
    rows, starts = record["runs"], list[np.ndarray]()
    ends, colour_ends = np.cumsum(rows["cells"]), np.cumsum(rows["colours"])
    for end, n_cells in zip(ends.tolist(), rows["cells"].tolist()):
        cells, counts = record["cells"][end - n_cells : end], record["counts"][end - n_cells : end]
        before = np.append(0, np.cumsum(counts, dtype=np.int64))
        starts.append(before[np.searchsorted(cells, bounds)])
    palettes = [record["palettes"][end - n : end] for end, n in zip(colour_ends.tolist(), rows["colours"].tolist())]
    return _RunFile(path, rows, np.array(starts, np.int64).reshape(len(rows), len(bounds)), palettes)


def _read_run(stream: BinaryIO, row: np.ndarray, palette: np.ndarray, first: int, out: TriangleColumns) -> None:
    """Fill columns with the triangles of a run from `first` on."""
    offset, n = int(row["offset"]), int(row["triangles"])
    colours = np.empty(len(out.ids), np.uint8) if len(palette) else out.colours
    for column in (out.corners, out.ids, colours):
        size = column.itemsize * (column.shape[1] if column.ndim > 1 else 1)
        stream.seek(offset + first * size)
        read_into(stream, column)
        offset += n * size
    if len(palette):
        out.colours[:] = palette[colours]


# --- Buckets of triangles in temporary files --------------------------------------------------------------------------


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
