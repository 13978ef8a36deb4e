"""The triangles of a store in the order of their faces, for work that goes over surfaces.

Chunks are sorted by place. All triangles at once are gathered in memory; otherwise one pass over the chunks writes the
corners to a scratch file, in buckets of consecutive faces, each of which is put in order when it is read. Faces without
an area are in no chunk, so they become points, at the lowest corner of the store's box.
"""

import weakref
from collections.abc import Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.files import temporary_folder

if TYPE_CHECKING:
    from .store_file import Store
    from .stored_cutouts import StoredCutouts

_BUCKET = 1 << 16  # faces
_ROW = np.dtype([("face", "<i4"), ("corners", "<f4", (3, 3))])  # of a bucket, from its first face on


class StoredTriangles(NamedTuple):
    """All triangles of a store."""

    vertices: NDArray[np.float32]  # (n, 3, 3) recentred
    colour: NDArray[np.float32]  # (n, 3)


def gather_triangles(store: "Store", cutouts: "StoredCutouts | None") -> StoredTriangles:
    """All triangles in the order of their faces, in memory; `cutouts`: those of the store."""
    n = store.n_triangles
    found = StoredTriangles(np.empty((n, 3, 3), np.float32), np.ones((n, 3), np.float32))
    found.vertices[:] = store.meta.box[0]
    for faces, corners, colours in _parts(store, cutouts):
        found.vertices[faces], found.colour[faces] = corners, colours
    return found


def every_triangle(store: "Store", cutouts: "StoredCutouts | None", step: int) -> NDArray[np.float32]:
    """(m, 3, 3) float32, recentred: the corners of every step-th face; `cutouts`: those of the store."""
    found = np.empty((-(-store.n_triangles // step), 3, 3), np.float32)
    found[:] = store.meta.box[0]
    for faces, corners, _ in _parts(store, cutouts):
        some = np.flatnonzero(faces % step == 0)
        found[faces[some] // step] = corners[some]
    return found


class _Part(NamedTuple):
    """Some faces of a store, valid until the next part is read."""

    faces: NDArray[np.integer]
    corners: NDArray[np.float32]  # (k, 3, 3) recentred
    colours: NDArray[np.float32]  # (k, 3)


def _parts(store: "Store", stored: "StoredCutouts | None") -> Iterator[_Part]:
    """Yield the solid faces of each chunk, the cut-outs, and the clear faces; each face once."""
    memory = store.memory()
    cut = np.empty(0, np.int32) if stored is None else np.union1d(stored.cutouts.faces, stored.clear.faces)
    for each in store.ranges:
        for k in range(each.chunks.start, each.chunks.stop):
            chunk = store.chunk(k, memory)
            part = _Part(
                each.faces(chunk.tree.prim_ids), chunk.tree.corners.reshape(-1, 3, 3), chunk.palette[chunk.palette_rows]
            )
            if len(cut):  # if one of them is the first face of a file, a chunk has a point for it
                solid = cut.take(np.searchsorted(cut, part.faces), mode="clip") != part.faces
                part = part if solid.all() else _Part(*(column[solid] for column in part))
            yield part
    if stored is not None:
        yield _Part(stored.cutouts.faces, stored.corners.reshape(-1, 3, 3), stored.colours)
        yield _Part(stored.clear.faces, stored.clear.corners.reshape(-1, 3, 3), stored.clear.colours)


class FaceCorners:
    """The corners of any faces of a store, from a scratch file that is removed with this object.

    cutouts : those of the store

    Raises
    ------
    InputError
        If the file cannot be written.
    """

    def __init__(self, store: "Store", cutouts: "StoredCutouts | None"):
        self._lowest, n = store.meta.box[0], store.n_triangles
        self._filled = np.zeros(-(-n // _BUCKET), np.int64)  # rows in each bucket
        self._last: tuple[int, NDArray[np.float32]] | None = None  # the bucket that was read last
        with ExitStack() as stack:
            self._path = stack.enter_context(temporary_folder()) / "faces"
            try:
                with self._path.open("wb") as stream:
                    for faces, corners, _ in _parts(store, cutouts):
                        self._add(stream, faces, corners)
            except OSError as error:
                where = f"its faces take {n * _ROW.itemsize / 1e9:,.1f} GB in {self._path.parent.parent}"
                raise InputError(f"{store.path.name}: {where} ({error.strerror}); set TMPDIR to another disk") from None
            self.close = weakref.finalize(self, stack.pop_all().close)

    def _add(self, stream: BinaryIO, faces: NDArray[np.integer], corners: NDArray[np.float32]) -> None:
        """Append the faces of a part to their buckets."""
        order = np.argsort(faces)
        rows = np.empty(len(order), _ROW)
        rows["face"], rows["corners"] = faces[order] % _BUCKET, corners[order]
        buckets, first = np.unique(faces[order] // _BUCKET, return_index=True)
        for bucket, part in zip(buckets.tolist(), np.split(rows, first[1:])):
            stream.seek((bucket * _BUCKET + int(self._filled[bucket])) * _ROW.itemsize)
            stream.write(part.data)
            self._filled[bucket] += len(part)

    def of(self, faces: NDArray[np.integer]) -> NDArray[np.float32]:
        """(m, 3, 3) float32, recentred: the corners of faces, (m,) int."""
        corners, buckets = np.empty((len(faces), 3, 3), np.float32), faces // _BUCKET
        for k in np.unique(buckets).tolist():
            some = buckets == k
            corners[some] = self._bucket(k)[faces[some] - k * _BUCKET]
        return corners

    def _bucket(self, k: int) -> NDArray[np.float32]:
        """The corners of the faces of a bucket."""
        last = self._last
        if last is None or last[0] != k:
            rows = np.fromfile(self._path, _ROW, int(self._filled[k]), offset=k * _BUCKET * _ROW.itemsize)
            corners = np.empty((_BUCKET, 3, 3), np.float32)
            corners[:] = self._lowest
            corners[rows["face"]] = rows["corners"]
            self._last = last = k, corners
        return last[1]
