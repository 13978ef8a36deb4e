"""The scene of a store with further faces in memory, such as the plants of a city that is larger than memory.

The faces follow those of the store, in its frame. They are traced with its cut-outs, so no file is written; a solid one
has a mask that nothing passes.
"""

from collections.abc import Iterator
from copy import copy
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..scene.alpha_masks import DARK, Cutouts, TexelMask, join_cutouts, mask_columns
from ..scene.joined_scenes import joined_system
from ..scene.materials import CLAMP
from ..scene.scene_bounds import Detail
from ..scene.scene_data import MemoryData
from ..scene.triangles import Triangles
from .face_order import gather_triangles
from .store_checks import check_one_range
from .store_data import ALL_BYTES, StoreData, all_triangles
from .stored_cutouts import CUTOUT_BYTES, ClearFaces, StoredCutouts
from .stored_looks import LooksPart, SceneLooks

_NO_LIGHT = np.array([[DARK + 1] * 3 + [1]], np.int32)  # the depths of a mask, which closest hits meet


class _Faces(NamedTuple):
    """Faces in memory, in the frame of a store."""

    vertices: NDArray[np.float32]  # (m, 3, 3)
    colours: NDArray[np.float32]  # (m, 3)
    blocking: Cutouts  # those that block some light, numbered from 0 on
    clear: NDArray[np.int64]  # (k,): all others


class ExtendedStoreData(StoreData):
    """A store, and after its faces and objects those of a scene in memory, at rest.

    Its frame is that of the store. In memory, both together have another one if the plants reach beyond the bounds, or
    if all coordinates of the store are those of float32: results then differ by the rounding of coordinates. So does
    the default camera, since a sample of all faces would have to be read from all chunks.

    Raises
    ------
    InputError
        If int32 cannot number the faces, or both scenes have a unit, and these differ.
    """

    def __init__(self, below: StoreData, more: MemoryData, name: str):
        below = copy(below)
        self.__dict__.update(below.__getstate__())
        self.__dict__.pop("max_memory", None)  # a property here
        check_one_range(name, below.n_triangles + more.n_triangles)
        self._below, self._corners, self.name = below, more.corners(), name
        self.notes = (*below.notes, *more.notes)
        self.crs, self.given_unit = joined_system(below, more)
        self.objects = [*below.objects, *more.objects]
        self._more_owners = more.object_of_face + np.int32(len(below.objects))
        (low, high), (lower, upper) = below.bounds, more.bounds
        self.bounds = np.stack([np.minimum(low, lower), np.maximum(high, upper)])
        self._faces, self._more_cutouts = _faces_of(more, self.origin), more.cutouts

    @property
    def max_memory(self) -> int | None:
        """The limit of the store below, which reads its own faces by it."""
        return self._below.max_memory

    @max_memory.setter
    def max_memory(self, size: int | None) -> None:
        self._below.max_memory = size

    @property
    def n_triangles(self) -> int:
        return self._below.n_triangles + len(self._corners)

    @property
    def box(self) -> NDArray[np.float32]:
        box, vertices = self._below.box, self._faces.vertices.reshape(-1, 3)
        return np.stack([np.minimum(box[0], vertices.min(0)), np.maximum(box[1], vertices.max(0))])

    @property
    def terrain(self) -> None:
        """None: the surface is no longer a raster of heights alone."""

    @property
    def terrain_towards(self) -> None:
        """None, as `terrain`."""

    def cell_tops(self, window: Any = None) -> None:
        """None, as `terrain`."""

    @property
    def framed_points(self) -> NDArray[np.float64] | None:
        points = self._below.framed_points
        return None if points is None else np.concatenate([points, self._corners.reshape(-1, 3)])

    @property
    def detail(self) -> Detail | None:
        return self._below.detail

    @property
    def has_cutouts(self) -> bool:
        return True

    @property
    def lets_light_pass(self) -> bool:
        return self._below.lets_light_pass or self._more_cutouts is not None

    @property
    def cutouts(self) -> Cutouts | None:
        """The faces that let light pass, without the solid ones that are traced with them."""
        more, none = self._more_cutouts, np.empty(0, np.int32)
        if more is not None:
            more = more._replace(solid=none, faces=more.faces + np.int32(self._below.n_triangles))
        joined = join_cutouts([(self._below.cutouts, 0), (more, 0)])
        return joined if joined is not None and len(joined.faces) else None

    @property
    def cutout_bytes(self) -> int:
        return self._below.cutout_bytes + CUTOUT_BYTES * len(self._corners)

    @cached_property
    def stored_cutouts(self) -> StoredCutouts:
        below, (vertices, colours, more, clear) = self._below.stored_cutouts, self._faces
        first, corners = self._below.n_triangles, vertices.reshape(-1, 9)
        moved = more._replace(faces=more.faces + np.int32(first))
        added = ClearFaces((clear + first).astype(np.int32), corners[clear], colours[clear])
        if below is None:
            return StoredCutouts(moved, corners[more.faces], colours[more.faces], added)
        joined = join_cutouts([(below.cutouts, 0), (moved, 0)])
        assert joined is not None
        return StoredCutouts(
            joined,
            np.concatenate([below.corners, corners[more.faces]]),
            np.concatenate([below.colours, colours[more.faces]]),
            ClearFaces(*(np.concatenate(pair) for pair in zip(below.clear, added))),
        )

    @cached_property
    def stored_looks(self) -> SceneLooks | None:
        looks = self._below.stored_looks
        return None if looks is None else looks.with_part(LooksPart(self._below.n_triangles, None))

    @property
    def object_of_face(self) -> NDArray[np.int32]:
        return np.concatenate([self._below.object_of_face, self._more_owners])

    def triangles(self, time: float = 0.0, threads: int | None = None) -> Triangles:
        self.clamped(time)
        self.check_all(ALL_BYTES)
        stored = gather_triangles(self.store, self._below.stored_cutouts)
        vertices, colours = (np.concatenate(pair) for pair in zip(stored, self._faces[:2]))
        clear = self.stored_cutouts.clear
        return all_triangles(vertices, colours, self.origin, self.cutouts, clear.faces, threads)

    def every(self, step: int, time: float, threads: int | None = None) -> NDArray[np.float32]:
        first = -self._below.n_triangles % step
        return np.concatenate([self._below.every(step, time, threads), self._faces.vertices[first::step]])

    def corners(self, time: float = 0.0, faces: NDArray[np.integer] | None = None) -> NDArray[np.float64]:
        n = self._below.n_triangles
        if faces is None:
            return np.concatenate([self._below.corners(time), self._corners])
        out, in_memory = np.empty((len(faces), 3, 3)), faces >= n
        out[in_memory] = self._corners[faces[in_memory] - n]
        if not in_memory.all():
            out[~in_memory] = self._below.corners(time, faces[~in_memory])
        return out

    def content(self, time: float, threads: int | None = None) -> Iterator[memoryview | bytes]:
        yield from self._below.content(time, threads)
        for array in self._corners, self._faces.colours, self._more_owners, *self._faces.blocking:
            yield np.ascontiguousarray(array).data


def _faces_of(scene: MemoryData, origin: NDArray[np.float64]) -> _Faces:
    """The faces of a scene in the frame at an origin; solid ones get the last mask."""
    from ..kernels.parallel import thread_count
    from ..scene.triangle_setup import gather

    n, found = scene.n_triangles, scene.cutouts
    vertices, first = np.empty((n, 3, 3), np.float32), 0
    for piece in scene.source.pieces(0.0):
        first += gather(piece, origin, vertices[first:], thread_count(None)).count
    opaque = TexelMask((1, 1, CLAMP, CLAMP), np.zeros(1, np.uint8), _NO_LIGHT, np.empty((0, 1, 4), np.int32))
    none = np.empty(0, np.int32)
    solid_only = Cutouts(none, none, np.empty((0, 3, 2), np.float32), none, **mask_columns([opaque]))
    joined = join_cutouts([(found._replace(solid=none), 0), (solid_only, 0)]) if found is not None else solid_only
    assert joined is not None
    mask = np.full(n, -1, np.int32)
    mask[np.arange(n) if found is None else found.solid] = len(joined.shapes) - 1
    uv = np.zeros((n, 3, 2), np.float32)
    if found is not None:
        mask[found.faces], uv[found.faces] = found.mask, found.uv
    faces = np.flatnonzero(mask >= 0).astype(np.int32)
    blocking = joined._replace(solid=none, faces=faces, uv=uv[faces], mask=mask[faces])
    return _Faces(vertices, scene.colours, blocking, np.flatnonzero(mask < 0))
